"""Joint states of several publishers in a bag: merged, unwrapped, and what is left out."""

from __future__ import annotations

from conftest import planar_urdf
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.bag_writer import BagWriter, JOINT_STATE
from redundant_planner.io.joint_chunk import JointChunk
from redundant_planner.io.joint_chunks import ChosenJoints, JointBatch, JointsMissingError
from redundant_planner.io.left_out import LeftOut

ORIGIN = 1_700_000_000 * 10**9
# Swings of three joints, the last of which turns on and on.
SPEEDS = np.array([0.7, -0.4, 1.5])


def posture(time):
    return np.array([np.sin(time), 0.5 * np.cos(2.0 * time), 1.5 * time + 2.0])


def velocity(time):
    return np.array([np.cos(time), -np.sin(2.0 * time), 1.5])


def message(time, joints, extra=(), wraps=True):
    """A joint state with some of the joints 'abc', and others of 9."""
    q = posture(time)
    if wraps:
        q[2] = np.angle(np.exp(1j * q[2]))
    made = JointState(
        name=[*(joint for joint in joints), *extra],
        position=[*(q['abc'.index(joint)] for joint in joints), *[9.0] * len(extra)],
        velocity=[*(velocity(time)['abc'.index(joint)] for joint in joints), *[0.0] * len(extra)])
    made.header.stamp.sec, made.header.stamp.nanosec = divmod(ORIGIN + round(time * 1e9), 10**9)
    return bytes(serialize_message(made))


def in_parts(seconds=8.0):
    """Two publishers at 100 and 40 Hz, and a gripper's (time, message)."""
    listed = [(0.01 * i, message(0.01 * i, 'ba', ['finger'])) for i in range(round(100 * seconds))]
    listed += [(t, message(t, 'c')) for t in np.arange(0.003, seconds, 0.025)]
    listed += [(t, message(t, '', ['finger'])) for t in np.arange(0.001, seconds, 0.05)]
    return sorted(listed, key=lambda entry: entry[0])


def merged(listed, size=50, names=('a', 'b', 'c')):
    """What is chosen out of messages that are read so many at a time, and what is left out."""
    left_out = LeftOut()
    batch, chosen, found = JointBatch('joint_states', left_out), None, []
    chosen = ChosenJoints('joint_states', names, left_out)
    for i, (time, raw) in enumerate(listed):
        batch.add(time, raw)
        if i % size == size - 1:
            found += [chosen.of(chunk) for chunk in batch.chunk(ORIGIN)]
    found += [chosen.of(chunk) for chunk in batch.chunk(ORIGIN)] + [chosen.rest()]
    chunks = [chunk for chunk in found if chunk is not None]
    return JointChunk('joint_states', names, *(
        np.concatenate([getattr(chunk, part) for chunk in chunks])
        for part in ('arrivals', 'stamps', 'positions', 'velocities', 'present'))), left_out


@pytest.mark.parametrize('size', [1, 7, 50, 4000])
def test_parts_are_joined_to_what_the_arm_did(size):
    """At the moments of the joint that comes most often, but for those before all are known."""
    found, left_out = merged(in_parts(), size)
    assert len(found.stamps) == 799 and found.present.all()
    np.testing.assert_allclose(np.diff(found.stamps), 0.01, atol=1e-6)
    expected = np.array([posture(time) for time in found.stamps])
    # The end is held, as nothing is known of what comes then.
    np.testing.assert_allclose(found.positions[:-3], expected[:-3], atol=1e-4)
    np.testing.assert_allclose(found.positions, expected, atol=0.05)
    np.testing.assert_allclose(
        found.velocities[:-3], [velocity(time) for time in found.stamps[:-3]], atol=1e-3)
    assert left_out.sentences() == ['160 messages on joint_states are left out: they are of other '
                                    'joints']


def test_all_at_once_and_in_parts_are_joined_too():
    listed = [(0.01 * i, message(0.01 * i, 'abc' if i % 200 < 100 else 'ab')) for i in range(600)]
    listed += [(t, message(t, 'c')) for t in np.arange(1.0, 6.0, 0.01) if t % 2.0 >= 1.0]
    found, _ = merged(sorted(listed, key=lambda entry: entry[0]))
    np.testing.assert_allclose(
        found.positions, [posture(time) for time in found.stamps], atol=0.02)
    assert len(found.stamps) >= 590


def test_a_part_that_falls_silent_is_held_and_one_that_never_comes_is_named():
    listed = [(0.01 * i, message(0.01 * i, 'ab')) for i in range(800)]
    listed += [(t, message(t, 'c')) for t in np.arange(0.0, 3.0, 0.01)]
    found, _ = merged(sorted(listed, key=lambda entry: entry[0]))
    assert len(found.stamps) == 800
    assert np.ptp(found.positions[350:, 2]) == 0.0
    chosen = ChosenJoints('joint_states', ('a', 'b', 'c'), LeftOut())
    batch = JointBatch('joint_states', LeftOut())
    batch.add(0.0, message(0.0, 'ab'))
    for chunk in batch.chunk(ORIGIN):
        assert chosen.of(chunk) is None
    assert chosen.rest() is None
    with pytest.raises(JointsMissingError, match=r"\['c'\] were not recorded"):
        chosen.check_found()


def test_a_clock_that_is_set_back_begins_anew():
    listed = in_parts(2.0)
    found, _ = merged(listed + listed)
    assert (np.diff(found.stamps) < 0.0).sum() == 1
    assert len(found.stamps) == 2 * 199


def test_a_bag_of_wrapped_parts_has_continuous_curves(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        for time, raw in in_parts():
            bag.write('/joint_states', ORIGIN + round(time * 1e9), raw)
    with open_bag(tmp_path / 'bag') as bag:
        assert bag.topics == {'joint_states': len(in_parts())}
    urdf = planar_urdf(('revolute', 'revolute', 'continuous'))
    for i, name in enumerate('abc', start=1):
        urdf = urdf.replace(f'"joint{i}"', f'"{name}"')
    (tmp_path / 'arm.urdf').write_text(urdf)
    analysis = analyse(tmp_path / 'bag', urdf=str(tmp_path / 'arm.urdf'), tip='tip')
    curves = analysis.curves
    assert analysis.joint_names == ('a', 'b', 'c')
    assert np.abs(np.diff(curves.positions, axis=0)).max() < 0.1
    assert np.ptp(curves.positions[:, -1]) == pytest.approx(12.0, abs=0.1)

"""What the other process says when the planner has died, without any process."""

from __future__ import annotations

import mmap
import struct

from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.nodes.command_memory import CommandMemory, NotedCommand
from redundant_planner.nodes.second_process import Brief, speak, STOPS

PERIOD, LIMITS, JERK = 0.004, np.array([2.0, 5.0, 0.5]), np.array([100.0, 300.0, 20.0])
BRIEF = Brief('planner_node', '/', {}, (), ('a', 'b', 'c'), (-1.0,) * 3, (1.0,) * 3,
              tuple(LIMITS), tuple(JERK), PERIOD, 0)
VELOCITIES = st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3).map(np.array)


class Listener:
    """Hears commands, and finds their publisher after a while; time passes as one sleeps."""

    def __init__(self, late=0.0, found_at=0.0):
        self.now, self.found_at, self.heard = 10.0 + late, 10.0 + found_at, []

    def sleep(self, seconds):
        self.now += seconds

    def listeners(self):
        return {'joint_command': int(self.now >= self.found_at)}

    def publish(self, stamp_ns, positions, velocities):
        self.heard.append((self.now, stamp_ns, positions, velocities))

    def wait_until_heard(self, seconds):
        self.now += seconds


def spoken(velocities, change=0.0, **times):
    listener = Listener(**times)
    last = NotedCommand(
        10.0, 5_000_000_000, np.zeros(3), velocities, velocities - change * LIMITS * PERIOD)
    speak(BRIEF, last, listener, 1, lambda: listener.now, listener.sleep)
    return listener.heard


@given(VELOCITIES, st.floats(0.0, 0.1), st.floats(-1.0, 1.0))
def test_it_brakes_within_the_limits_and_ends_in_a_stop(velocities, late, change):
    heard = spoken(velocities, change, late=late)
    times = np.array([10.0, *(now for now, *_ in heard)])
    commanded = np.array([velocities, *(dq for *_, dq in heard)])
    assert not commanded[-STOPS:].any()
    assert (np.diff(times)[1:] >= 0.999 * PERIOD).all() and times[1] - 10.0 >= 0.999 * PERIOD
    assert (np.abs(np.diff(commanded, axis=0)) <= LIMITS * PERIOD * (1.0 + 1e-9)).all()
    if velocities.any():
        changes = np.vstack((change * LIMITS * PERIOD, np.diff(commanded, axis=0)))
        jerk = np.diff(changes, axis=0) / PERIOD**2
        assert (np.abs(jerk) <= JERK * (1.0 + 1e-9) + 1e-6).all()
    np.testing.assert_allclose([stamp / 1e9 for _, stamp, *_ in heard], times[1:] - 5.0)


def test_a_drive_that_has_long_stopped_is_not_set_in_motion_again():
    assert not any(dq.any() for *_, dq in spoken(np.ones(3), late=1.0))


def test_who_finds_it_late_hears_the_stop_all_the_same():
    heard = spoken(np.ones(3), found_at=3.0)
    assert heard[-1][0] >= 13.0 and not heard[-1][3].any()
    assert spoken(np.ones(3), found_at=1e9)[-1][0] < 30.0


@given(st.lists(VELOCITIES, min_size=1, max_size=5))
def test_a_note_that_is_not_finished_leaves_the_one_before(notes):
    with mmap.mmap(-1, 1 << 16) as shared:
        writer, reader = CommandMemory(shared), CommandMemory(shared)
        assert writer.prepare(3) and reader.prepare(3)
        assert reader.latest() is None
        for i, dq in enumerate(notes):
            before = reader.latest()
            writer.note(i, 2.0 * dq, dq)
            if before is not None:
                # As if death had come before the count.
                count, = struct.unpack_from('@Q', shared)
                struct.pack_into('@Q', shared, 0, count - 1)
                np.testing.assert_array_equal(reader.latest().velocities, before.velocities)
                struct.pack_into('@Q', shared, 0, count)
            latest = reader.latest()
            assert latest.stamp_ns == i
            np.testing.assert_array_equal(latest.velocities, dq)
            np.testing.assert_array_equal(latest.positions, 2.0 * dq)
            np.testing.assert_array_equal(latest.before, notes[i - 1] if i else np.zeros(3))


@pytest.mark.parametrize('joints, fits', [(7, True), (1000, True), (10_000, False)])
def test_it_takes_as_many_joints_as_there_is_room_for(joints, fits):
    with mmap.mmap(-1, 1 << 16) as shared:
        assert CommandMemory(shared).prepare(joints) is fits

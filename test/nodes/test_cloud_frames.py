"""Where the frame of a cloud is: the base frame, or what tf2 says of the cloud's stamp."""

from __future__ import annotations

import sys
from types import SimpleNamespace

from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
import numpy as np
import pytest
import rclpy
from ros_domains import next_domain

from redundant_planner.core.errors import ObstacleError
from redundant_planner.io.cloud_writer import cloud_bytes
from redundant_planner.nodes import cloud_obstacles
from redundant_planner.nodes.joint_messages import JointWriter
from redundant_planner.nodes.transforms import transform_lookup
from redundant_planner.perception.voxel_grid import centers_of

STAMP = 1_700_000_000_000_000_000  # [ns]


class TransformError(Exception):
    """What tf2 raises for a moment that it knows nothing of yet."""


class FakeBuffer:
    """tf2's buffer, of a camera that moves along x at 1 m/s from a moment on."""

    known_until_ns = STAMP

    def lookup_transform(self, target, source, time):
        if source != 'camera':
            raise TransformError(f'"{source}" does not exist')
        moment = time.nanoseconds or self.known_until_ns
        if moment > self.known_until_ns:
            raise TransformError('into the future')
        return SimpleNamespace(transform=SimpleNamespace(
            translation=SimpleNamespace(x=(moment - STAMP) * 1e-9, y=0.5, z=0.25),
            rotation=SimpleNamespace(x=0.0, y=0.0, z=np.sqrt(0.5), w=np.sqrt(0.5))))


@pytest.fixture
def tf2(monkeypatch):
    fake = SimpleNamespace(Buffer=FakeBuffer, TransformListener=lambda buffer, node: buffer,
                           TransformException=TransformError)
    monkeypatch.setitem(sys.modules, 'tf2_ros', fake)
    monkeypatch.setattr(FakeBuffer, 'known_until_ns', STAMP)


def test_a_transform_is_that_of_its_moment(tf2):
    lookup = transform_lookup(SimpleNamespace(), 'base')
    FakeBuffer.known_until_ns = STAMP + 10**9
    assert lookup('camera')[0] == pytest.approx([1.0, 0.5, 0.25])
    origin, axes = lookup('camera', STAMP + 10**8)
    assert origin == pytest.approx([0.1, 0.5, 0.25], abs=1e-6)
    np.testing.assert_allclose(axes, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    with pytest.raises(ObstacleError, match='tf2 knows no way from there to base: into the fut'):
        lookup('camera', STAMP + 2 * 10**9)


@pytest.fixture
def node(monkeypatch):
    """A node without an executor: what it publishes and says is kept, time stands still."""
    rclpy.init(args=['--ros-args', '--params-file', str(ROBOTS / 'panda.yaml'), '-p',
                     f'urdf:={PANDA_URDF}', '-p', 'min_points:=1'], domain_id=next_domain())
    try:
        made = cloud_obstacles.CloudObstacles()
        made.sent, made.said, made.time = [], [], 100.0
        monkeypatch.setattr(made._obstacles, 'publish', made.sent.append)
        monkeypatch.setattr(made, '_warn', made.said.append)
        monkeypatch.setattr(cloud_obstacles, 'time', SimpleNamespace(monotonic=lambda: made.time))
        writer = JointWriter(make_panda().joint_names)
        states = [(writer.message(STAMP + i * 10**7, PANDA_READY, np.zeros(7)), 0)
                  for i in range(-20, 20)]
        monkeypatch.setattr(made._joints, 'fetch_stamped',
                            lambda: [states.pop(0) for _ in range(len(states))])
        yield made
        made.destroy_node()
    finally:
        rclpy.shutdown()


def show(node, frame, stamp_ns=STAMP):
    points = np.array([[[0.31, 0.41, 0.61]]])
    node._on_cloud(cloud_bytes(points, frame, stamp_ns))
    centers = node._filter.memory.keys
    node._filter.memory.clear()
    return [tuple(c) for c in centers_of(centers, 0.025).tolist()]


def test_a_cloud_waits_for_its_transform_and_is_given_up_in_the_end(tf2, node):
    """The camera's x is the base's y."""
    assert show(node, 'camera') == [pytest.approx((-0.4125, 0.8125, 0.8625))]
    assert len(node.sent) == 1
    show(node, 'camera', STAMP + 10**8)
    assert len(node.sent) == 1 and not node.said  # it waits
    FakeBuffer.known_until_ns = STAMP + 2 * 10**8
    node._work()
    assert len(node.sent) == 2 and not node.said
    show(node, 'moon')
    node.time += 0.3
    node._work()
    assert len(node.sent) == 2
    assert node.said == ["points ignored: they are in frame 'moon'; sensor_pose is not set, and "
                         'tf2 knows no way from there to panda_link0: "moon" does not exist']
    show(node, 'camera')
    assert len(node.sent) == 3


def test_of_clouds_that_come_while_one_waits_only_the_newest_stays(tf2, node):
    for i in range(1, 6):
        show(node, 'camera', STAMP + i * 10**7)
    FakeBuffer.known_until_ns = STAMP + 10**9
    node._work()
    stamps = [int.from_bytes(raw[8:12], 'little') * 10**9 + int.from_bytes(raw[12:16], 'little')
              for raw in node.sent]
    assert stamps == [STAMP + 10**7, STAMP + 5 * 10**7]


def test_without_tf2_a_cloud_in_an_unknown_frame_is_refused_at_once(node, monkeypatch):
    monkeypatch.setattr(node, '_transform', None)
    assert show(node, 'camera') == []
    assert "they are in frame 'camera', and nobody knows where that is" in node.said[0]
    assert 'tf2_ros is not installed' in node.said[0] and node._waiting is None
    assert show(node, 'panda_link0') == [pytest.approx((0.3125, 0.4125, 0.6125))]


def test_a_fault_in_the_filter_costs_its_cloud_and_no_more(node, monkeypatch):
    def fail(*arguments):
        raise ZeroDivisionError

    with monkeypatch.context() as broken:
        broken.setattr(node._filter, 'see', fail)
        with pytest.raises(ZeroDivisionError):  # which the node's guard catches
            show(node, 'panda_link0')
    assert node._waiting is None and not node.sent
    assert len(show(node, 'panda_link0')) == 1

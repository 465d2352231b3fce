"""~/body: what one planner publishes of its arm, another reads as capsules that move like it."""

from __future__ import annotations

import itertools

from conftest import examples, make_panda, PANDA_READY
from hypothesis import given, settings, strategies as st
import numpy as np
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.obstacles import shapes
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.io.obstacle_tracker import ObstacleTracker
from redundant_planner.nodes.body_writer import BodyWriter

PANDA = make_panda()
HELD = PANDA.holding([Obstacle.box('box', (0.0, 0.0, 0.15), (0.05, 0.05, 0.1))])
# The base stands still, and is none of them.
MOVED = {robot: list(itertools.compress(range(len(robot.capsules)), robot.moved))
         for robot in (PANDA, HELD)}
numbers = st.lists(st.floats(-1.0, 1.0), min_size=7, max_size=7).map(np.array)


@settings(max_examples=examples(25), deadline=None)
@given(numbers, numbers, st.sampled_from([PANDA, HELD]))
def test_the_capsules_arrive_where_they_are_and_move_as_they_do(turn, dq, robot):
    tracker, q = ObstacleTracker((), [robot.base_frame]), PANDA_READY + turn
    raw = BodyWriter(robot, 'left').message(12_500_000_000, robot.kinematics(q), dq)
    assert not tracker.update(raw, 1.0)
    scene, step = tracker.scene, 1e-5
    assert scene.names == tuple(
        f'left/{robot.capsules[c].name}/{i}' for i, c in enumerate(MOVED[robot]))
    assert set(scene.shapes) == {shapes.CAPSULE}
    before, after = robot.kinematics(q - step * dq), robot.kinematics(q + step * dq)
    for i, c in enumerate(MOVED[robot]):
        capsule = robot.capsules[c]
        half = scene.half_extents[i]
        np.testing.assert_allclose(half[:2], capsule.radius)
        axis = (half[2] - half[0]) * scene.rotations[i][:, 2]
        for sign, name in ((-1.0, 'segment_start'), (1.0, 'segment_end')):
            here = getattr(robot.kinematics(q), name)[c]
            np.testing.assert_allclose(scene.centers[i] + sign * axis, here, atol=1e-9)
            moved = (getattr(after, name)[c] - getattr(before, name)[c]) / (2.0 * step)
            told = scene.velocities[i] + np.cross(
                scene.angular_velocities[i], here - scene.centers[i])
            np.testing.assert_allclose(told, moved, atol=1e-5)


def test_any_ros_tool_can_read_it_and_what_was_let_go_of_is_gone():
    tracker = ObstacleTracker((), [PANDA.base_frame])
    for robot in (HELD, PANDA):
        raw = BodyWriter(robot, 'left').message(1_000_000_007, robot.kinematics(PANDA_READY),
                                                np.zeros(7))
        markers = deserialize_message(raw, MarkerArray).markers
        assert markers[0].action == Marker.DELETEALL
        assert [m.ns for m in markers[1:]] == [
            f'left/{robot.capsules[c].name}' for c in MOVED[robot]]
        assert all(m.header.stamp.sec == 1 and m.header.stamp.nanosec == 7 for m in markers[1:])
        tracker.update(raw, 0.0)
        assert len(tracker.scene.names) == len(MOVED[robot])


def test_an_arm_that_falls_silent_counts_as_at_rest():
    tracker = ObstacleTracker((), [PANDA.base_frame])
    tracker.update(BodyWriter(PANDA, 'left').message(
        1, PANDA.kinematics(PANDA_READY), np.ones(7)), 1.0)
    tracker.expire(1.2)
    assert tracker.scene.velocities.any()
    tracker.expire(1.4)
    assert not tracker.scene.velocities.any() and not tracker.scene.angular_velocities.any()
    assert len(tracker.scene.names) == len(MOVED[PANDA])

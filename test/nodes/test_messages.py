"""Messages to core types, good and bad (no ROS communication)."""

from __future__ import annotations

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import TwistStamped
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.errors import StateError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.io.obstacle_tracker import ObstacleTracker
from redundant_planner.nodes.messages import (
    markers_of,
    positions_from_message,
    stamped_twist_from_bytes,
    twist_from_bytes,
    twist_to_message,
)

NAMES = ('a', 'b', 'c')


def test_joint_order_and_extra_joints_do_not_matter():
    message = JointState(name=['finger', 'c', 'a', 'b'], position=[9.0, 3.0, 1.0, 2.0])
    np.testing.assert_array_equal(positions_from_message(message, NAMES), [1.0, 2.0, 3.0])


@pytest.mark.parametrize(('names', 'values', 'message'), [
    (['a', 'b'], [1.0, 2.0], r"joints are missing: 'c'; the message has 'a', 'b'"),
    (['a', 'b', 'x'], [1.0, 2.0, 3.0], r"joints are missing: 'c'"),
    (['a', 'b', 'c', 'a'], [1.0, 2.0, 3.0, 4.0], r"appear twice: 'a'"),
    (['a', 'b', 'c'], [1.0, 2.0], r'3 joint names came with 2 position values'),
    (['a', 'b', 'c'], [1.0, np.nan, 3.0], r"position of joint 'b' is nan"),
    ([], [], r'joints are missing'),
])
def test_bad_joint_states_are_refused_by_name(names, values, message):
    with pytest.raises(StateError, match=message):
        positions_from_message(JointState(name=names, position=values), NAMES)


def test_twists_pass_through_and_bad_ones_do_not():
    twist = np.array([1.0, 2.0, 3.0, -1.0, -2.0, -3.0])
    raw = bytes(serialize_message(twist_to_message(twist)))
    np.testing.assert_array_equal(twist_from_bytes(raw), twist)
    for bad in (np.inf, np.nan, 1e308, -1.1e3):
        twist[4] = bad
        with pytest.raises(StateError, match='must be finite, up to 1000 m/s'):
            twist_from_bytes(bytes(serialize_message(twist_to_message(twist))))
    for length in range(len(raw)):
        with pytest.raises(StateError):
            twist_from_bytes(raw[:length])


@pytest.mark.parametrize('frame', ['', 'tip', 'ten letters', 'fünf\n'])
def test_stamped_twists_are_read_by_their_bytes(frame):
    message = TwistStamped(twist=twist_to_message(np.arange(6.0)))
    message.header.frame_id = frame
    message.header.stamp = Time(sec=-5, nanosec=250_000_000)
    raw = bytes(serialize_message(message))
    stamp, read, twist = stamped_twist_from_bytes(raw)
    assert (stamp, read) == (-4.75, frame)
    np.testing.assert_array_equal(twist, np.arange(6.0))
    for length in range(len(raw)):
        with pytest.raises(StateError):
            stamped_twist_from_bytes(raw[:length])
    for lie in (257, 2**31, 2**32 - 1):
        with pytest.raises(StateError, match='up to 255'):
            stamped_twist_from_bytes(raw[:12] + lie.to_bytes(4, 'little') + raw[16:])


BALL = Obstacle('ball', np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3]),
                np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]))


def marker(**changes):
    result = markers_of([BALL], 'base').markers[0]
    for name, value in changes.items():
        target = result
        *path, last = name.split('__')
        for part in path:
            target = getattr(target, part)
        setattr(target, last, value)
    return result


def book_with(*markers, static=()):
    book = ObstacleTracker(static, ['', 'base'])
    problems = book.update(serialize_message(MarkerArray(markers=list(markers))), 0.0)
    return book, problems


def test_a_marker_is_the_ellipsoid_it_came_from():
    book, problems = book_with(marker())
    assert not problems and book.scene.names == ('ball/0',)
    np.testing.assert_allclose(book.scene.centers[0], BALL.center)
    np.testing.assert_allclose(book.scene.half_extents[0], BALL.half_extents)
    np.testing.assert_allclose(book.scene.rotations[0], BALL.rotation)


@pytest.mark.parametrize(('change', 'message'), [
    ({'scale__x': 0.0}, 'scale'), ({'scale__y': -1.0}, 'scale'),
    ({'pose__orientation__w': 5.0}, 'quaternion'), ({'pose__position__x': np.nan}, 'finite'),
    ({'header__frame_id': 'moon'}, r"frame 'moon'; it must be in '', 'base'"),
    ({'pose__position__y': 1e300}, 'finite numbers up to 1e.06 m'),
    ({'scale__z': 1e-300}, 'from 1e-06 to 1e.06 m'), ({'scale__z': 1e300}, 'scale'),
    ({'pose__orientation__z': 1e200}, 'quaternion'),
    ({'lifetime__sec': -1}, 'lifetime of -1 s'),
    ({'type': Marker.ARROW}, 'must be SPHERE'), ({'action': 7}, 'action 7'),
])
def test_a_bad_marker_changes_nothing_and_the_others_count(change, message):
    book, problems = book_with(marker())
    other = marker(id=5)
    problems = book.update(serialize_message(MarkerArray(markers=[marker(**change), other])), 1.0)
    assert len(problems) == 1
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(problems[0])
    assert set(book.scene.names) == {'ball/0', 'ball/5'}
    np.testing.assert_allclose(book.scene.centers[0], BALL.center)


def test_a_zero_quaternion_is_refused():
    _, problems = book_with(marker(pose__orientation__z=0.0, pose__orientation__w=0.0))
    assert 'of length 0' in problems[0]


def test_markers_are_modified_and_deleted_by_identity():
    static = [Obstacle('wall', np.zeros(3), np.ones(3))]
    book, _ = book_with(marker(), marker(id=1), static=static)
    book.update(serialize_message(MarkerArray(markers=[marker(pose__position__x=7.0)])), 0.0)
    assert book.scene.centers[1, 0] == 7.0 and len(book.scene.names) == 3
    book.update(serialize_message(MarkerArray(markers=[marker(action=Marker.DELETE)])), 0.0)
    assert book.scene.names == ('wall', 'ball/1')
    book.update(serialize_message(MarkerArray(markers=[marker(action=Marker.DELETEALL)])), 0.0)
    assert book.scene.names == ('wall',)


def test_a_lifetime_ends_and_the_scene_stays_the_same_object_until_then():
    book, _ = book_with(marker(lifetime=Duration(sec=0, nanosec=500_000_000)), marker(id=1))
    scene = book.scene
    book.expire(0.4)
    assert book.scene is scene
    book.expire(0.5)
    assert book.scene.names == ('ball/1',)

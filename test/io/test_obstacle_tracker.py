"""Obstacles from markers: shapes, frames, velocities, thousands of them."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from conftest import examples
from geometry_msgs.msg import Point
from hypothesis import given, settings, strategies as st
import numpy as np
import pinocchio as pin
import pytest
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles import shapes
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.io import obstacle_tracker
from redundant_planner.io.obstacle_tracker import MOST_FRAMES, MOST_OBSTACLES, ObstacleTracker


def marker(number=0, at=(0.0, 0.0, 0.0), kind=Marker.SPHERE, stamp=0.0, frame='base', **fields):
    made = Marker(ns='o', id=number, type=kind, **fields)
    made.header.frame_id = frame
    made.header.stamp = Time(sec=int(stamp), nanosec=round(stamp % 1.0 * 1e9))
    made.pose.position.x, made.pose.position.y, made.pose.position.z = map(float, at)
    made.pose.orientation.w = 1.0
    made.scale.x, made.scale.y, made.scale.z = 0.2, 0.4, 0.6
    return made


def tell(book, now, *markers):
    return book.update(serialize_message(MarkerArray(markers=list(markers))), now)


@pytest.mark.parametrize(('kind', 'scale', 'shape', 'half'), [
    (Marker.SPHERE, (0.2, 0.4, 0.6), shapes.ELLIPSOID, (0.1, 0.2, 0.3)),
    (Marker.CUBE, (0.2, 0.4, 0.6), shapes.BOX, (0.1, 0.2, 0.3)),
    (Marker.CYLINDER, (0.4, 0.4, 0.6), shapes.CYLINDER, (0.2, 0.2, 0.3)),
    (Marker.CYLINDER, (0.4, 0.398, 0.6), shapes.CYLINDER, (0.2, 0.2, 0.3)),
    (Marker.CYLINDER, (0.2, 0.4, 0.6), shapes.BOX, (0.1, 0.2, 0.3))])
def test_markers_are_the_shapes_that_they_show(kind, scale, shape, half):
    book, told = ObstacleTracker([], ['base']), marker(kind=kind)
    told.scale.x, told.scale.y, told.scale.z = scale
    assert not tell(book, 0.0, told)
    assert book.scene.shapes.tolist() == [shape]
    np.testing.assert_allclose(book.scene.half_extents, [half])


@pytest.mark.parametrize(('kind', 'shape', 'half'), [
    (Marker.SPHERE_LIST, shapes.ELLIPSOID, (0.1, 0.2, 0.3)),
    (Marker.CUBE_LIST, shapes.BOX, (0.1, 0.2, 0.3)),
    (Marker.POINTS, shapes.BOX, (0.2, 0.2, 0.2))])
def test_a_list_is_one_obstacle_at_each_of_its_points(kind, shape, half):
    book, told = ObstacleTracker([], ['base']), marker(kind=kind, at=(1.0, 0.0, 0.0))
    told.points = [Point(x=0.5), Point(y=0.25)]
    o = told.pose.orientation
    o.z, o.w = math.sqrt(0.5), math.sqrt(0.5)  # a quarter turn: x becomes y, y becomes −x
    assert not tell(book, 0.0, told)
    assert book.scene.names == ('o/0', 'o/0') and book.scene.shapes.tolist() == [shape] * 2
    np.testing.assert_allclose(
        book.scene.centers, [[1.0, 0.5, 0.0], [0.75, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(book.scene.rotations[1][:, 0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(book.scene.half_extents, [half, half])


@pytest.mark.parametrize(('kind', 'ends'), [
    (Marker.LINE_STRIP, [(0, 1), (1, 2)]), (Marker.LINE_LIST, [(0, 1)])])
def test_lines_are_capsules(kind, ends):
    points = np.array([[0.0, 0.0, 0.0], [0.3, 0.4, 0.0], [0.3, 0.4, -0.2]])
    book, told = ObstacleTracker([], ['base']), marker(kind=kind)
    told.points = [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]
    assert not tell(book, 0.0, told)
    assert book.scene.shapes.tolist() == [shapes.CAPSULE] * len(ends)
    for i, (start, end) in enumerate(ends):
        half = book.scene.half_extents[i]
        np.testing.assert_allclose(half[:2], 0.1)  # half of scale.x
        axis = (half[2] - half[0]) * book.scene.rotations[i][:, 2]
        np.testing.assert_allclose(book.scene.centers[i] - axis, points[start], atol=1e-12)
        np.testing.assert_allclose(book.scene.centers[i] + axis, points[end], atol=1e-12)


def test_a_list_comes_goes_and_ends_as_a_whole():
    def cubes(count, life=0.0):
        told = marker(7, kind=Marker.CUBE_LIST)
        told.points = [Point(x=float(i)) for i in range(count)]
        told.lifetime.nanosec = round(1e9 * life)
        return told

    book = ObstacleTracker([], ['base'])
    tell(book, 0.0, marker(), cubes(3))
    assert book.scene.names == ('o/0', 'o/7', 'o/7', 'o/7')
    tell(book, 0.1, cubes(1, life=0.5))
    assert book.scene.names == ('o/0', 'o/7')
    book.expire(0.5)
    assert len(book.scene.names) == 2
    book.expire(0.7)
    assert book.scene.names == ('o/0',)
    tell(book, 1.0, cubes(2))
    tell(book, 1.1, marker(7, action=Marker.DELETE))
    assert book.scene.names == ('o/0',)
    # A name stands for one thing: a list becomes a sphere, a sphere a list.
    tell(book, 1.2, cubes(2))
    tell(book, 1.3, marker(7))
    assert book.scene.names == ('o/0', 'o/7') and not book.scene.shapes.any()
    tell(book, 1.4, cubes(2))
    assert book.scene.names == ('o/0', 'o/7', 'o/7')
    tell(book, 1.5, marker(0, action=Marker.DELETEALL))
    assert book.scene.names == ()


def test_a_list_that_comes_again_takes_its_own_room(monkeypatch):
    monkeypatch.setattr('redundant_planner.io.obstacle_tracker.MOST_OBSTACLES', 4)
    book, told = ObstacleTracker([], ['base']), marker(7, kind=Marker.CUBE_LIST)
    for i in range(3):
        told.points = [Point(x=float(i)), Point(), Point()]
        assert not tell(book, 0.1 * i, told)
        assert book.scene.centers[0, 0] == i and len(book.scene.names) == 3


@pytest.mark.parametrize('now', [math.nan, -math.inf])
def test_a_listing_whose_obstacles_are_dropped_at_once_is_not_taken_for_known(now):
    book, told = ObstacleTracker([], ['base']), marker(1)
    told.lifetime.sec = 1
    for _ in range(3):
        tell(book, now, told)
    assert len(book._tracks.expiry) == len(book.scene.names)


@pytest.mark.parametrize(('point', 'count', 'problem'), [
    (math.nan, 1, 'point 1 at'), (2e6, 1, 'point 1 at'), (0.0, MOST_OBSTACLES, 'room for 4')])
def test_a_bad_list_changes_nothing(point, count, problem, monkeypatch):
    monkeypatch.setattr('redundant_planner.io.obstacle_tracker.MOST_OBSTACLES', 4)
    book, told = ObstacleTracker([], ['base']), marker(7, kind=Marker.CUBE_LIST)
    told.points = [Point(), Point()]
    assert not tell(book, 0.0, told)
    told.points = [Point()] + [Point(z=point)] * min(count, 9)
    problems = tell(book, 0.1, told)
    assert len(problems) == 1 and "'o/7'" in problems[0] and problem in problems[0]
    assert len(book.scene.names) == 2


def test_a_text_says_how_fast_a_marker_moves():
    book, told = ObstacleTracker([], ['base'], estimate_velocity=True), marker(1, kind=Marker.CUBE)
    told.text = 'twist 0.1 0 -2e-1 0 0 0.5'
    other = marker(2)
    other.text = 'a text about anything'
    assert not tell(book, 0.0, told, other)
    np.testing.assert_allclose(book.scene.velocities, [[0.1, 0.0, -0.2], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(book.scene.angular_velocities[0], [0.0, 0.0, 0.5])
    # It counts for more than what successive poses say, and holds while messages come.
    told.pose.position.x = 1.0
    assert not tell(book, 0.5, told)
    np.testing.assert_allclose(book.scene.velocities[0], [0.1, 0.0, -0.2])
    book.expire(1.0)
    assert not book.scene.velocities.any()
    assert not tell(book, 1.1, told)
    told.text = ''
    told.header.stamp.sec = 1
    assert not tell(ObstacleTracker([], ['base']), 0.0, told)
    book.estimate_velocity = False
    assert not tell(book, 1.2, told)
    assert not book.scene.velocities.any()


def test_a_list_moves_like_one_body():
    def transform(frame):
        return np.array([1.0, 0.0, 0.0]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])

    book, told = ObstacleTracker([], ['base'], transform=transform), marker(kind=Marker.CUBE_LIST)
    told.header.frame_id = 'cart'
    told.points = [Point(), Point(x=0.5)]
    told.text = 'twist 0.2 0 0 0 0 1'
    assert not tell(book, 0.0, told)
    # The cart's x axis is the base's y.
    np.testing.assert_allclose(
        book.scene.velocities, [[0.0, 0.2, 0.0], [-0.5, 0.2, 0.0]], atol=1e-12)
    np.testing.assert_allclose(book.scene.angular_velocities, [[0.0, 0.0, 1.0]] * 2)
    book.expire(0.4)
    assert not book.scene.velocities.any() and len(book.scene.names) == 2


@pytest.mark.parametrize('text', [
    'twist 1 2 3', 'twist a b c d e f', 'twist 1 2 3 4 5 nan', 'twist 1e9 0 0 0 0 0',
    'twist ' + '1 ' * 1000])
def test_a_twist_that_is_none_is_refused_and_the_obstacle_stays_as_it_was(text):
    book = ObstacleTracker([], ['base'])
    tell(book, 0.0, marker(1, kind=Marker.CUBE))
    told = marker(1, at=(1.0, 0.0, 0.0), kind=Marker.CUBE)
    told.text = text
    problems = tell(book, 0.1, told)
    assert len(problems) == 1 and "begins with 'twist', but no six numbers follow" in problems[0]
    np.testing.assert_array_equal(book.scene.centers, [[0.0, 0.0, 0.0]])


def test_an_obstacle_that_turns_has_an_angular_velocity():
    book = ObstacleTracker([], ['base'], estimate_velocity=True)
    turned = marker(1, kind=Marker.CUBE)
    tell(book, 0.0, marker(0), turned)
    for one in (turned, ball := marker(0)):
        one.pose.orientation.z, one.pose.orientation.w = math.sin(0.05), math.cos(0.05)
    ball.scale.y = ball.scale.z = ball.scale.x
    tell(book, 0.1, ball, turned)
    np.testing.assert_allclose(book.scene.angular_velocities[1], [0.0, 0.0, 1.0], atol=1e-9)
    # A ball looks the same from everywhere.
    assert not book.scene.angular_velocities[0].any()
    # What calls its axes differently has not turned.
    turned.pose.orientation.z = turned.pose.orientation.w = math.sqrt(0.5)
    tell(book, 0.2, turned)
    assert not book.scene.angular_velocities[1].any()
    turned.pose.orientation.z, turned.pose.orientation.w = math.sin(0.8), math.cos(0.8)
    tell(book, 0.3, turned)
    assert book.scene.angular_velocities[1].any()
    book.expire(1.0)
    assert not book.scene.angular_velocities.any()


def test_the_velocity_comes_from_successive_poses_by_their_stamps():
    book = ObstacleTracker([], ['base'], estimate_velocity=True)
    tell(book, 0.0, marker(stamp=10.0), marker(1))
    np.testing.assert_array_equal(book.scene.velocities, 0.0)
    tell(book, 0.5, marker(at=(0.01, 0.0, -0.02), stamp=10.1), marker(1, at=(0.0, 0.3, 0.0)))
    np.testing.assert_allclose(book.scene.velocities[0], [0.1, 0.0, -0.2], atol=1e-9)
    # Without stamps the time of arrival counts.
    np.testing.assert_allclose(book.scene.velocities[1], [0.0, 0.6, 0.0], atol=1e-9)
    # The same measurement once more is no standstill; a leap is no motion.
    tell(book, 0.6, marker(at=(0.01, 0.0, -0.02), stamp=10.1))
    np.testing.assert_allclose(book.scene.velocities[0], [0.1, 0.0, -0.2], atol=1e-9)
    tell(book, 0.7, marker(at=(5.0, 0.0, 0.0), stamp=10.2))
    np.testing.assert_array_equal(book.scene.velocities[0], 0.0)
    # Whatever is silent for a while stands still.
    book.expire(0.75)
    assert book.scene.velocities[1].any()
    book.expire(1.0)
    np.testing.assert_array_equal(book.scene.velocities, 0.0)


def test_velocities_are_not_estimated_unasked():
    book = ObstacleTracker([], ['base'])
    tell(book, 0.0, marker())
    tell(book, 0.1, marker(at=(0.01, 0.0, 0.0)))
    np.testing.assert_array_equal(book.scene.velocities, 0.0)


def test_other_frames_are_looked_up_or_refused_by_name():
    turn = pin.exp3(np.array([0.0, 0.0, np.pi / 2]))

    def transform(frame):
        if frame != 'camera':
            raise ObstacleError('tf2 knows no way from there')
        return np.array([1.0, 0.0, 0.0]), turn

    book = ObstacleTracker([], ['base'], transform=transform)
    problems = tell(book, 0.0, marker(at=(0.1, 0.0, 0.0), frame='camera'), marker(1, frame='moon'),
                    marker(2))
    assert problems == ["obstacle 'o/1' is given in frame 'moon'; tf2 knows no way from there"]
    assert book.scene.names == ('o/0', 'o/2')
    np.testing.assert_allclose(book.scene.centers, [[1.0, 0.1, 0.0], [0.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(book.scene.rotations[0], turn, atol=1e-12)


def test_a_message_is_applied_in_its_order():
    book = ObstacleTracker([], ['base'])
    tell(book, 0.0, marker(), marker(1))
    tell(book, 0.0, marker(2), marker(action=Marker.DELETEALL), marker(3),
         marker(3, action=Marker.DELETE), marker(4), marker(4, at=(1.0, 0.0, 0.0)))
    assert book.scene.names == ('o/4',)
    np.testing.assert_array_equal(book.scene.centers, [[1.0, 0.0, 0.0]])


def test_a_scene_that_is_told_again_is_the_same_object():
    book = ObstacleTracker([Obstacle('wall', np.zeros(3), np.ones(3))], ['base'])
    tell(book, 0.0, marker(), marker(1))
    scene = book.scene
    tell(book, 1.0, marker(), marker(1))
    assert book.scene is scene
    tell(book, 2.0, marker(1, at=(0.0, 0.1, 0.0)))
    assert book.scene is not scene and scene.centers[2, 1] == 0.0


def test_many_problems_are_summed_up():
    book = ObstacleTracker([], ['base'])
    problems = tell(book, 0.0, *(marker(i, kind=Marker.ARROW) for i in range(50)))
    assert len(problems) == 4 and problems[-1] == '47 more obstacles like that'
    assert 'no MarkerArray' in book.update(b'nonsense', 0.0)[0]


def test_a_thousand_markers_keep_their_identity():
    random = np.random.default_rng(0)
    book = ObstacleTracker([], ['base'])
    places = random.normal(size=(1000, 3))
    tell(book, 0.0, *(marker(i, at=p) for i, p in enumerate(places)))
    order = random.permutation(1000)
    places += 0.1
    tell(book, 0.1, *(marker(int(i), at=places[i]) for i in order))
    assert book.scene.names == tuple(f'o/{i}' for i in range(1000))
    np.testing.assert_allclose(book.scene.centers, places)


def test_a_detector_that_sees_nothing_any_more():
    """Empty messages after others: what was remembered of those no longer holds."""
    book = ObstacleTracker([], ['base'])
    for told in ([marker(), marker(1)], [], [], [marker()], [], [],
                 [marker(i) for i in range(3)],
                 [marker(i, action=Marker.DELETE) for i in range(3)], [], []):
        assert tell(book, 0.0, *told) == []
    assert book.scene.names == ()


def test_more_obstacles_than_are_kept_in_mind_are_refused(monkeypatch):
    monkeypatch.setattr(obstacle_tracker, 'MOST_OBSTACLES', 3)
    book = ObstacleTracker([], ['base'])
    assert tell(book, 0.0, *(marker(i) for i in range(5))) == [
        '2 obstacles are too many: up to 3 are kept']
    assert book.scene.names == ('o/0', 'o/1', 'o/2')
    assert tell(book, 0.0, marker(0, action=Marker.DELETE)) == []
    assert tell(book, 0.0, marker(4)) == [] and book.scene.names == ('o/1', 'o/2', 'o/4')


def test_too_many_frames_are_refused_without_being_looked_up():
    asked = []

    def transform(frame):
        asked.append(frame)
        return np.zeros(3), np.eye(3)

    book = ObstacleTracker([], ['base'], transform=transform)
    problems = tell(book, 0.0, *(marker(i, frame=f'f{i}') for i in range(1000)))
    assert len(asked) == len(book.scene.names) == MOST_FRAMES
    assert "obstacle 'o/20' is given in frame 'f20'" in problems[0] and len(problems) == 4


@pytest.mark.parametrize(('origin', 'scale'), [
    (np.array([np.nan, 0.0, 0.0]), 1.0), (np.array([2e6, 0.0, 0.0]), 1.0), (np.zeros(3), np.nan)])
def test_a_transform_to_nowhere_is_refused(origin, scale):
    book = ObstacleTracker([], ['base'], transform=lambda frame: (origin, scale * np.eye(3)))
    assert 'takes finite numbers' in tell(book, 0.0, marker(at=(0.1, 0.0, 0.0), frame='far'))[0]
    assert not book.scene.names


@pytest.mark.parametrize(('center', 'semi_axes', 'problem'), [
    ((1e300, 0.0, 0.0), (0.1, 0.1, 0.1), "obstacle 'wall' is at .* up to 1e.06 m"),
    ((0.0, 0.0, 0.0), (0.1, 1e-300, 0.1), "obstacle 'wall' has the scale .* from 1e-06"),
    ((0.0, 0.0, 0.0), (1e9, 1.0, 0.1), "obstacle 'wall' has the scale")])
def test_the_same_bounds_hold_for_static_obstacles(center, semi_axes, problem):
    good = Obstacle('wall', np.zeros(3), np.ones(3))
    book = ObstacleTracker([good], ['base'])
    with pytest.raises(ObstacleError, match=problem):
        book.static = [Obstacle('wall', np.array(center), np.array(semi_axes))]
    assert book.static == (good,) and book.scene.half_extents[0, 0] == 1.0


@pytest.mark.parametrize('gap', [1e-9, 1e-6, 5e-4])
def test_stamps_next_to_each_other_are_one_measurement(gap):
    book = ObstacleTracker([], ['base'], estimate_velocity=True)
    tell(book, 0.0, marker(stamp=10.0))
    tell(book, 0.1, marker(at=(0.01, 0.0, 0.0), stamp=10.1))
    tell(book, 0.1, marker(at=(0.0101, 0.0, 0.0), stamp=10.1 + gap))
    np.testing.assert_allclose(book.scene.velocities[0], [0.1, 0.0, 0.0], atol=1e-9)
    np.testing.assert_array_equal(book.scene.centers[0], [0.0101, 0.0, 0.0])


def test_a_clock_that_was_set_back_does_not_freeze_a_velocity():
    book = ObstacleTracker([], ['base'], estimate_velocity=True)
    tell(book, 0.0, marker(stamp=1e9))
    tell(book, 0.1, marker(at=(0.01, 0.0, 0.0), stamp=1e9 + 0.1))
    assert book.scene.velocities[0, 0] > 0.09
    tell(book, 0.2, marker(at=(0.02, 0.0, 0.0), stamp=5.0))
    np.testing.assert_array_equal(book.scene.velocities, 0.0)
    tell(book, 0.3, marker(at=(0.02, 0.01, 0.0), stamp=5.1))
    np.testing.assert_allclose(book.scene.velocities[0], [0.0, 0.1, 0.0], atol=1e-9)


class Reference:
    """The rules of the book, one marker after another, nothing remembered but the obstacles."""

    def __init__(self, transform):
        self.known, self.transform = {}, transform

    def update(self, told, now):
        """Apply markers; return how many were wrong."""
        wrong = 0
        for m in told:
            key = f'{m.ns}/{m.id}' if m.ns else str(m.id)
            if m.action == Marker.DELETEALL:
                self.known.clear()
            elif m.action == Marker.DELETE:
                self.known.pop(key, None)
            elif m.action != Marker.ADD or m.type not in (1, 2, 3) or m.scale.x <= 0.0 or (
                    m.header.frame_id == 'moon'):
                wrong += 1
            else:
                self.add(key, m, now)
        return wrong

    def add(self, key, m, now):
        p, half = m.pose.position, 0.5 * np.array([m.scale.x, m.scale.y, m.scale.z])
        center = np.array([p.x, p.y, p.z])
        if m.header.frame_id == 'camera':
            center = center + self.transform('camera')[0]
        stamp = m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec or now
        before = self.known.get(key)
        velocity, last = np.zeros(3), stamp
        if before is not None:
            elapsed = stamp - before['stamp']
            if -0.3 <= elapsed < 1e-3:
                velocity, last = before['velocity'], before['stamp']
            elif elapsed > 0.0:
                velocity = (center - before['center']) / elapsed
                if np.linalg.norm(velocity) >= 3.0:
                    velocity = np.zeros(3)
        life = m.lifetime.sec + 1e-9 * m.lifetime.nanosec
        self.known[key] = {'center': center, 'axes': half, 'velocity': velocity,
                           'stamp': last, 'heard': now, 'end': now + life if life else np.inf}

    def expire(self, now):
        self.known = {key: o for key, o in self.known.items() if o['end'] > now}
        for o in self.known.values():
            if now - o['heard'] > 0.3:
                o['velocity'] = np.zeros(3)


ACTIONS = [Marker.ADD] * 8 + [Marker.DELETE, Marker.DELETE, Marker.DELETEALL, 1]


@st.composite
def messages(draw, before):
    """The message before once more with other numbers, or any other, an empty one included."""
    kind = draw(st.sampled_from(['same'] * 4 + ['some', 'any', 'any', 'empty']))
    if kind == 'empty':
        return []
    if kind == 'any' or not before:
        told = [Marker(
            ns=draw(st.sampled_from(['', 'o', 'name'])), id=draw(st.integers(0, 2)),
            text=draw(st.sampled_from(['', 'longer']))) for _ in range(draw(st.integers(1, 5)))]
        odd = draw(st.booleans())
        for m in told:  # like a detector, or anything
            m.type = draw(st.sampled_from([1, 2, 2, 3, 0])) if odd else Marker.SPHERE
            m.action = draw(st.sampled_from(ACTIONS)) if odd else Marker.ADD
            m.header.frame_id = draw(st.sampled_from(
                ['base'] * 6 + ['camera', 'moon'])) if odd else 'base'
        told[0].action = draw(st.sampled_from([Marker.ADD, Marker.DELETEALL]))
    else:
        told = before[:draw(st.integers(0, len(before)))] if kind == 'some' else list(before)
    flaws = [-1.0] if draw(st.integers(0, 5)) == 0 else []
    lives = draw(st.sampled_from([[0], [0], [0, 5 * 10**8]]))
    for m in told:
        p = m.pose.position
        p.x, p.y, p.z = (draw(st.sampled_from([0.0, 0.01, -0.02, 0.3])) for _ in range(3))
        m.pose.orientation.w = 1.0
        m.scale.y = m.scale.z = 0.4
        m.scale.x = draw(st.sampled_from([0.2, 0.2, *flaws]))
        m.header.stamp = Time(sec=draw(st.sampled_from([0] * 3 + [1000])),
                              nanosec=draw(st.sampled_from([0, 1000, 10**8, 2 * 10**8])))
        m.lifetime.nanosec = draw(st.sampled_from(lives))
    return told


@settings(deadline=None, max_examples=examples(120))
@given(st.data())
def test_any_sequence_of_messages_leads_where_its_markers_lead_one_by_one(data):
    def transform(frame):
        if frame != 'camera':
            raise ObstacleError('tf2 knows no way from there')
        return np.array([1.0, 0.0, 0.0]), np.eye(3)

    book = ObstacleTracker([], ['base'], transform=transform, estimate_velocity=True)
    reference, told, now = Reference(transform), [], 2.0
    for _ in range(data.draw(st.integers(2, 8))):
        now += data.draw(st.sampled_from([0.0, 0.03, 0.2, 0.5]))
        told = data.draw(messages(told))
        wrong = reference.update(told, now)
        assert len(tell(book, now, *told)) == (wrong if wrong <= 3 else 4)
        if data.draw(st.booleans()):
            now += 0.02
            reference.expire(now)
            book.expire(now)
        scene, known = book.scene, reference.known
        assert sorted(scene.names) == sorted(known)
        for i, name in enumerate(scene.names):
            np.testing.assert_allclose(scene.centers[i], known[name]['center'], atol=1e-12)
            np.testing.assert_allclose(scene.half_extents[i], known[name]['axes'], rtol=1e-12)
            np.testing.assert_allclose(
                scene.velocities[i], known[name]['velocity'], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize('kind', [-1, -10, 9, 10, 11, 2**31 - 1])
def test_a_marker_that_deletes_may_be_of_any_type(kind):
    book = ObstacleTracker((), ['base'])
    assert not tell(book, 0.0, marker(1), marker(2))
    assert not tell(book, 0.0, marker(1, kind=kind, action=Marker.DELETE), marker(3))
    assert book.scene.names == ('o/2', 'o/3')


def test_what_is_hidden_comes_back_where_it_was_last_seen():
    book = ObstacleTracker([Obstacle('o/7', (0.0, 0.0, 0.0), (0.1, 0.1, 0.1))], ['base'])
    points = marker(5, kind=Marker.POINTS, points=[Point(), Point(x=1.0)])
    assert not tell(book, 0.0, marker(7), marker(8), points)
    book.hidden = frozenset({'o/7', 'o/5'})
    # What the parameters name stays, whatever it is called.
    assert book.scene.names == ('o/7', 'o/8')
    scene = book.scene
    book.hidden = frozenset({'o/5', 'o/7'})
    assert book.scene is scene
    assert not tell(book, 0.0, marker(7, at=(0.5, 0.0, 0.0)), marker(8))
    assert book.scene.names == ('o/7', 'o/8')
    book.hidden = frozenset()
    assert book.scene.names == ('o/7', 'o/7', 'o/8', 'o/5', 'o/5')
    np.testing.assert_array_equal(book.scene.centers[1], [0.5, 0.0, 0.0])

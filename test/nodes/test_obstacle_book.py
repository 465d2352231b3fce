"""Obstacles from markers: shapes, frames, velocities, thousands of them."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from hypothesis import given, settings, strategies as st
import numpy as np
import pinocchio as pin
import pytest
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles import Obstacle
from redundant_planner.nodes.marker_reader import read_markers
from redundant_planner.nodes.obstacle_book import ObstacleBook


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


@pytest.mark.parametrize('kind', [Marker.CUBE, Marker.CYLINDER])
def test_boxes_and_cylinders_lie_inside_their_ellipsoids_and_touch_them(kind):
    book = ObstacleBook([], ['base'])
    assert not tell(book, 0.0, marker(kind=kind))
    half = np.array([0.1, 0.2, 0.3])
    if kind == Marker.CUBE:
        signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T
        points = signs * half
    else:
        turn = np.linspace(0.0, 2.0 * np.pi, 40)
        points = np.vstack([np.column_stack(
            (0.1 * np.cos(turn), 0.2 * np.sin(turn), np.full(40, z))) for z in (-0.3, 0.3)])
    levels = np.square(points / book.scene.semi_axes[0]).sum(axis=1)
    np.testing.assert_allclose(levels, 1.0)


def test_the_velocity_comes_from_successive_poses_by_their_stamps():
    book = ObstacleBook([], ['base'], estimate_velocity=True)
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
    book = ObstacleBook([], ['base'])
    tell(book, 0.0, marker())
    tell(book, 0.1, marker(at=(0.01, 0.0, 0.0)))
    np.testing.assert_array_equal(book.scene.velocities, 0.0)


def test_other_frames_are_looked_up_or_refused_by_name():
    turn = pin.exp3(np.array([0.0, 0.0, np.pi / 2]))

    def transform(frame):
        if frame != 'camera':
            raise ObstacleError('tf2 knows no way from there')
        return np.array([1.0, 0.0, 0.0]), turn

    book = ObstacleBook([], ['base'], transform=transform)
    problems = tell(book, 0.0, marker(at=(0.1, 0.0, 0.0), frame='camera'), marker(1, frame='moon'),
                    marker(2))
    assert problems == ["obstacle 'o/1' is given in frame 'moon'; tf2 knows no way from there"]
    assert book.scene.names == ('o/0', 'o/2')
    np.testing.assert_allclose(book.scene.centers, [[1.0, 0.1, 0.0], [0.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(book.scene.rotations[0], turn, atol=1e-12)


def test_a_message_is_applied_in_its_order():
    book = ObstacleBook([], ['base'])
    tell(book, 0.0, marker(), marker(1))
    tell(book, 0.0, marker(2), marker(action=Marker.DELETEALL), marker(3),
         marker(3, action=Marker.DELETE), marker(4), marker(4, at=(1.0, 0.0, 0.0)))
    assert book.scene.names == ('o/4',)
    np.testing.assert_array_equal(book.scene.centers, [[1.0, 0.0, 0.0]])


def test_a_scene_that_is_told_again_is_the_same_object():
    book = ObstacleBook([Obstacle('wall', np.zeros(3), np.ones(3))], ['base'])
    tell(book, 0.0, marker(), marker(1))
    scene = book.scene
    tell(book, 1.0, marker(), marker(1))
    assert book.scene is scene
    tell(book, 2.0, marker(1, at=(0.0, 0.1, 0.0)))
    assert book.scene is not scene and scene.centers[2, 1] == 0.0


def test_many_problems_are_summed_up():
    book = ObstacleBook([], ['base'])
    problems = tell(book, 0.0, *(marker(i, kind=Marker.ARROW) for i in range(50)))
    assert len(problems) == 4 and problems[-1] == '47 more obstacles like that'
    assert 'no MarkerArray' in book.update(b'nonsense', 0.0)[0]


def test_a_thousand_markers_keep_their_identity():
    random = np.random.default_rng(0)
    book = ObstacleBook([], ['base'])
    places = random.normal(size=(1000, 3))
    tell(book, 0.0, *(marker(i, at=p) for i, p in enumerate(places)))
    order = random.permutation(1000)
    places += 0.1
    tell(book, 0.1, *(marker(int(i), at=places[i]) for i in order))
    assert book.scene.names == tuple(f'o/{i}' for i in range(1000))
    np.testing.assert_allclose(book.scene.centers, places)


class Afresh:
    """A reader that takes every message for a new one."""

    def read(self, raw):
        return read_markers(raw)


@settings(deadline=None)
@given(st.data())
def test_obstacles_that_only_move_end_up_where_the_long_way_leads(data):
    """The same messages to a book that knows what is new and to one that does not."""
    quick, slow = (ObstacleBook([], ['base'], estimate_velocity=True) for _ in range(2))
    slow._reader = Afresh()
    numbers, now = list(range(3)), 0.0
    for _ in range(8):
        now += data.draw(st.sampled_from([0.03, 0.2, 0.5]))
        what = data.draw(st.sampled_from(['move'] * 5 + ['delete', 'fewer', 'wrong', 'shape']))
        if what == 'fewer':
            numbers = data.draw(st.permutations(range(3)))[:2]
        kind = Marker.CUBE if what == 'shape' else Marker.SPHERE
        told = [marker(i, at=data.draw(st.tuples(*[st.floats(-1, 1)] * 3)), kind=kind,
                       action=Marker.DELETE if what == 'delete' else Marker.ADD)
                for i in numbers]
        if what == 'wrong':
            told[0].scale.x = -1.0
        told[-1].lifetime.sec = data.draw(st.integers(0, 1))
        assert tell(quick, now, *told) == tell(slow, now, *told)
        quick.expire(now + 0.02)
        slow.expire(now + 0.02)
        assert quick.scene.names == slow.scene.names
        for field in ('centers', 'rotations', 'semi_axes', 'velocities'):
            np.testing.assert_array_equal(
                getattr(quick.scene, field), getattr(slow.scene, field))

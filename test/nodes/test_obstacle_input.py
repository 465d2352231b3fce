"""Messages on obstacles wait where they would delay a tick, and not for long."""

from __future__ import annotations

from types import SimpleNamespace

from geometry_msgs.msg import Point
from hypothesis import given, strategies as st
import pytest
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.nodes.guard import Guard
from redundant_planner.nodes.obstacle_input import ObstacleInput

PERIOD = 0.004


@pytest.fixture(scope='module')
def make_input():
    nowhere = SimpleNamespace(
        update=lambda raw, now, topic: [], refused=lambda topic: False)
    return lambda: ObstacleInput(['obstacles'], nowhere, PERIOD, Guard(pytest.fail), pytest.fail)


@given(st.lists(st.tuples(st.booleans(), st.floats(-PERIOD, 2.0 * PERIOD)), max_size=50),
       st.floats(0.0, 2.0 * PERIOD))
def test_no_message_is_put_off_more_than_twice(make_input, ticks, took):
    """Nor is any that fits in, nor one that would delay a tick at any time."""
    queue = make_input()
    queue.took = took
    times, waiting = 0, False
    for comes, left in ticks:
        if comes and not waiting:
            queue.on_message(b'')
            waiting = True
        if queue.put_off(left):
            times += 1
            assert waiting and times <= 2
            assert left < took < PERIOD
            continue
        assert not waiting or times == 2 or left >= took or took >= PERIOD
        queue.read(0.0)
        times, waiting = 0, False


def body(frame, kind=Marker.LINE_LIST, count=2):
    """A message like ~/body: a DELETEALL, and capsules in a frame."""
    markers = [Marker(action=Marker.DELETEALL)]
    for i in range(count):
        marker = Marker(ns='arm', id=i, type=kind, points=[Point(), Point(z=0.3)])
        marker.header.frame_id = frame
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = 0.1
        markers.append(marker)
    return bytes(serialize_message(MarkerArray(markers=markers)))


@pytest.fixture
def two_topics():
    """A queue of two topics, and what it has said."""
    said = []
    sources = ObstacleSources.of(2, (), ['base'], transform=None, estimate_velocity=False)
    return ObstacleInput(['obstacles', '/right/body'], sources, PERIOD, Guard(pytest.fail),
                         said.append), said


def heard(queue, raw, now, topic=1):
    queue.on_message(raw, topic)
    assert queue.read(now)


@pytest.mark.first_alone
@pytest.mark.parametrize('kind', [Marker.LINE_LIST, Marker.CUBE])
def test_a_topic_of_which_nothing_can_be_used_is_named_until_something_can(two_topics, kind):
    queue, said = two_topics
    for tick in range(1000):
        heard(queue, body('moon', kind), 0.02 * tick)
        heard(queue, body('base', kind), 0.02 * tick, topic=0)
        # A transform may be late.
        assert bool(queue.blind(0.02 * tick)) == (tick >= 50)
    assert queue.blind(20.0).startswith(
        'nothing on /right/body can be used, and the arm does not keep clear of it: ')
    assert "is given in frame 'moon'; it must be in 'base'" in queue.blind(20.0)
    # Said at the first message and every 10 s, each time of both markers.
    assert len(said) == 4 and all(sentence.startswith('/right/body ') for sentence in said)
    heard(queue, body('base', kind), 20.0)
    assert queue.blind(22.0) == ''
    heard(queue, body('moon', kind), 22.0)
    assert len(said) == 6


def test_a_message_sent_once_counts_and_so_does_one_that_is_none(two_topics):
    queue, _ = two_topics
    heard(queue, body('moon'), 0.0)
    assert queue.blind(0.5) == '' and 'frame' in queue.blind(60.0)
    heard(queue, b'\0\1\0\0 no message', 61.0, topic=0)
    assert 'nothing on obstacles can be used' in queue.blind(63.0)


def test_a_bad_message_among_good_ones_does_not_make_a_topic_useless(two_topics):
    queue, _ = two_topics
    heard(queue, body('base'), 0.0)
    for tick in range(9):
        heard(queue, body('moon'), 1.0 + tick)
    assert queue.blind(60.0) == ''
    heard(queue, body('moon'), 60.0)
    assert queue.blind(60.0) != ''


def test_one_marker_of_use_is_enough(two_topics):
    queue, said = two_topics
    good, bad = (Marker(ns='o', id=i, type=Marker.SPHERE) for i in range(2))
    for marker, frame in ((good, 'base'), (bad, 'moon')):
        marker.header.frame_id = frame
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = 0.1
    raw = bytes(serialize_message(MarkerArray(markers=[good, bad])))
    for tick in range(100):
        heard(queue, raw, 0.1 * tick)
    assert queue.blind(10.0) == '' and len(said) == 100

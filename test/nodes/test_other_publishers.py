"""Who publishes on a topic, and why nothing comes on it, in words."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from redundant_planner.nodes.other_publishers import publishers_of, why_nothing_comes

KIND = 'sensor_msgs/msg/JointState'


# As rclpy names a node of which the ROS graph has the publishers only.
HALF_FOUND = '_NODE_NAME_UNKNOWN_'


def publisher(name, kind=KIND, namespace='/left'):
    return SimpleNamespace(node_name=name, node_namespace=namespace, topic_type=kind)


def planner_with(publishers):
    return SimpleNamespace(
        resolve_topic_name='/left/{}'.format,
        get_publishers_info_by_topic=lambda topic: publishers,
        get_name=lambda: 'planner', get_namespace=lambda: '/left')


@pytest.mark.parametrize('others, has_second, count', [
    ([], True, 1),
    ([HALF_FOUND], True, 1),  # its own second process, at the start
    ([HALF_FOUND], False, 2),
    ([HALF_FOUND] * 2, True, 2),
    (['planner_last_word'], True, 1),
    (['planner_last_word', HALF_FOUND], True, 2),
    (['planner_last_word', 'other'], True, 2),
    (['other', HALF_FOUND], True, 2)])
def test_the_planners_second_process_is_no_second_publisher(others, has_second, count):
    planner = planner_with(list(map(publisher, ['planner', *others])))
    assert len(publishers_of(planner, 'joint_command', has_second=has_second)) == count


def test_another_planners_second_process_does_not_stand_for_ones_own():
    found = [publisher('planner'), publisher('planner_last_word', namespace='/right'),
             publisher(HALF_FOUND, namespace='_NODE_NAMESPACE_UNKNOWN_')]
    assert publishers_of(planner_with(found), 'joint_command', has_second=True) == [
        '/left/planner']


@pytest.mark.parametrize('publishers, words', [
    ([], "nobody publishes on '/left/joint_states'; does the arm's driver run"),
    ([publisher('arm')], "'/left/arm' publishes on '/left/joint_states', and nothing has come"),
    ([publisher('arm'), publisher('odd', 'std_msgs/msg/String')],
     "'/left/odd' publishes 'std_msgs/msg/String' on '/left/joint_states'; it must be "
     f"'{KIND}'")])
def test_publishers_and_their_type_are_named(publishers, words):
    assert why_nothing_comes(planner_with(publishers), 'joint_states', KIND).startswith(words)

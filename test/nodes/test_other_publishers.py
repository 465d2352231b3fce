"""Why nothing comes on a topic, in words."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from redundant_planner.nodes.other_publishers import why_nothing_comes

KIND = 'sensor_msgs/msg/JointState'


def publisher(name, kind=KIND):
    return SimpleNamespace(node_name=name, node_namespace='/left', topic_type=kind)


@pytest.mark.parametrize('publishers, words', [
    ([], "nobody publishes on '/left/joint_states'; does the arm's driver run"),
    ([publisher('arm')], "'/left/arm' publishes on '/left/joint_states', and nothing has come"),
    ([publisher('arm'), publisher('odd', 'std_msgs/msg/String')],
     "'/left/odd' publishes 'std_msgs/msg/String' on '/left/joint_states'; it must be "
     f"'{KIND}'")])
def test_publishers_and_their_type_are_named(publishers, words):
    node = SimpleNamespace(resolve_topic_name='/left/{}'.format,
                           get_publishers_info_by_topic=lambda topic: publishers)
    assert why_nothing_comes(node, 'joint_states', KIND).startswith(words)

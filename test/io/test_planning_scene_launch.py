"""What launch/planning_scene.launch.py starts: stand-ins for launch note it."""

from __future__ import annotations

from launch_stand_ins import launch_file
import pytest


@pytest.mark.parametrize(('arm', 'executables'), [
    ('true', ['fake_hardware_node', 'planner_node', 'planning_scene_obstacles']),
    ('false', ['planning_scene_obstacles'])])
def test_all_nodes_have_the_robot_and_the_arm_may_be_ones_own(
        monkeypatch, tmp_path, arm, executables):
    nodes = launch_file(monkeypatch, tmp_path, 'planning_scene', [])(arm=arm)
    assert [node.executable for node in nodes] == executables
    assert all(node.parameters[0].args == ('robot',) for node in nodes)

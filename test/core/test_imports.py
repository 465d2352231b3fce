"""What each folder may import."""

from __future__ import annotations

import ast
from pathlib import Path
import subprocess
import sys

import pytest

import redundant_planner

PACKAGE = Path(redundant_planner.__file__).parent
ROS = {'rclpy', 'rcl_interfaces', 'sensor_msgs', 'geometry_msgs', 'std_msgs',
       'visualization_msgs', 'diagnostic_msgs', 'moveit_msgs', 'ament_index_python'}


def imports(path: Path) -> set[str]:
    """Every module that a file names in an import, wherever it stands."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path}: relative import'
            names.add(node.module)
    return names


@pytest.mark.parametrize('path', sorted((PACKAGE / 'core').rglob('*.py')), ids=lambda p: p.stem)
def test_the_core_knows_neither_ros_nor_the_rest_of_the_package(path):
    for name in imports(path):
        top = name.split('.')[0]
        assert (top in {'numpy', 'numba', 'scipy', 'pinocchio', 'daqp'}
                or top in sys.stdlib_module_names
                or name.startswith('redundant_planner.core')), f'{path.name} imports {name}'
        # What says how long compiling takes has no part in planning.
        assert top not in {'time', 'logging', 'datetime'} or path.name == 'progress.py', (
            f'{path.name} imports {name}')


def test_only_nodes_and_live_tools_touch_ros():
    live = ('drive.py', 'go_to.py', 'live_run.py', 'quick_start.py', 'record_bag.py',
            'to_and_fro.py', 'playground.py', 'app.py', 'obstacle_sender.py',
            'planner_client.py')
    for path in PACKAGE.rglob('*.py'):
        if path.parent.name == 'nodes' or path.name in live:
            continue
        used = {name.split('.')[0] for name in imports(path)} & ROS
        assert not used, f'{path} imports {used}'


def test_only_three_files_know_the_library_for_bags():
    users = [p.name for p in PACKAGE.rglob('*.py')
             if any(n.startswith('rosbags') for n in imports(p))]
    assert sorted(users) == ['bag_reader.py', 'bag_writer.py', 'rosbags_internals.py']


@pytest.mark.parametrize('module', [
    'nodes.fake_hardware_node', 'nodes.scenario_player', 'tools.record_bag'])
def test_who_needs_no_mathematics_loads_none(module):
    """They start at once, and compile nothing."""
    code = (f'import sys, redundant_planner.{module}\n'
            'print(*{"numba", "pinocchio", "daqp", "scipy", "matplotlib"} & set(sys.modules))')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ''


def test_private_parts_of_rclpy_are_used_in_one_file():
    private = {'_subscriptions', '_parameter_overrides', 'take_message', 'rclpy_implementation'}
    for path in PACKAGE.rglob('*.py'):
        used = {node.attr for node in ast.walk(ast.parse(path.read_text()))
                if isinstance(node, ast.Attribute)} & private
        used |= {name for name in imports(path) if name.startswith('rclpy.impl')}
        assert not used or path.name == 'rclpy_internals.py', f'{path} uses {used}'

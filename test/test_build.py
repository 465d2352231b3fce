"""colcon builds, installs and starts the package as `ros2 run` would."""

from __future__ import annotations

import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time

from conftest import ROBOTS
from live_helpers import LIVE, PATIENCE
import pytest

SOURCE = Path(__file__).resolve().parent.parent
IGNORED = shutil.ignore_patterns('.*', '__pycache__', '*.egg-info', 'build', 'install', 'log',
                                 'demo_output')
EXECUTABLES = ('planner_node', 'fake_hardware_node', 'scenario_player', 'cloud_obstacles',
               'planning_scene_obstacles', 'depth_camera', 'mujoco_hardware_node', 'demo',
               'reproduce_paper', 'quick_start', 'drive', 'go_to', 'show_robot', 'playground')


def colcon(workspace: Path, *arguments: str) -> str:
    environment = dict(os.environ, COLCON_LOG_PATH=str(workspace / 'log'))
    done = subprocess.run(
        [sys.executable, '-m', 'colcon', *arguments], cwd=workspace, env=environment,
        capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope='module')
def workspace(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp('workspace')
    shutil.copytree(SOURCE, path / 'src' / 'redundant_planner', ignore=IGNORED)
    assert 'ros.ament_python' in colcon(path, 'list')
    colcon(path, 'build')
    return path


def test_everything_lies_where_ros2_looks_for_it(workspace):
    prefix = workspace / 'install' / 'redundant_planner'
    for name in EXECUTABLES:
        assert os.access(prefix / 'lib' / 'redundant_planner' / name, os.X_OK), name
    share = prefix / 'share' / 'redundant_planner'
    for name in ('package.xml', 'launch/demo.launch.py', 'launch/camera.launch.py',
                 'launch/two_arms.launch.py', 'config/planner/two_arms.yaml',
                 'launch/planning_scene.launch.py',
                 'launch/teleop.launch.py', 'config/devices/gamepad.yaml',
                 'launch/ros2_control.launch.py', 'config/ros2_control/panda_ros2_control.xml',
                 'config/ros2_control/panda_controllers.yaml',
                 'config/robots/paper_2p5r.urdf', 'config/scenarios/panda_camera.yaml',
                 'config/middleware/large_clouds.xml',
                 'config/robots/panda.yaml', 'config/planner/default.yaml',
                 'config/scenarios/paper.yaml', 'config/perception/panda.yaml',
                 'config/middleware/localhost_udp.xml'):
        assert (share / name).is_file(), name
    index = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages'
    assert (index / 'redundant_planner').is_file()


@LIVE
def test_the_installed_nodes_start_from_the_installed_files(workspace):
    """Sourced, from another folder, with the sources out of the way."""
    share = workspace / 'install' / 'redundant_planner' / 'share' / 'redundant_planner'
    robot = share / 'config' / 'robots' / 'paper_2p5r.yaml'
    assert robot.read_text() == (ROBOTS / 'paper_2p5r.yaml').read_text()
    # Compiling for yet another place would take a minute or more.
    environment = dict(os.environ, ROS_DOMAIN_ID='104', ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST',
                       NUMBA_DISABLE_JIT='1')
    sourced = f'source {workspace}/install/setup.bash && cd / && exec '
    module = subprocess.run(
        ['bash', '-c', f'{sourced} {sys.executable} -c '
         '"import redundant_planner; print(redundant_planner.__file__)"'],
        env=environment, capture_output=True, text=True, timeout=PATIENCE, check=True)
    assert module.stdout.startswith(f'{workspace}/install')
    library = workspace / 'install' / 'redundant_planner' / 'lib' / 'redundant_planner'
    logs = {node: workspace / f'{node}.log' for node in ('fake_hardware_node', 'planner_node')}
    nodes = []
    try:
        for node, log in logs.items():
            with log.open('w') as output:
                nodes.append(subprocess.Popen(
                    ['bash', '-c', f'{sourced} {library}/{node} --ros-args --params-file {robot}'],
                    env=environment, stderr=output))
        deadline = time.monotonic() + PATIENCE
        while not all(' Hz' in log.read_text() for log in logs.values()):
            assert time.monotonic() < deadline, [log.read_text() for log in logs.values()]
            assert all(node.poll() is None for node in nodes), 'both are alive'
            time.sleep(0.1)
        for node in nodes:
            node.send_signal(signal.SIGINT)
        assert [node.wait(PATIENCE) for node in nodes] == [0, 0]
    finally:
        for node in nodes:
            node.kill()
    assert not any('Traceback' in log.read_text() for log in logs.values())

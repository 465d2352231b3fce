"""colcon builds, installs and starts the package as `ros2 run` would."""

from __future__ import annotations

import os
from pathlib import Path
import shutil
import subprocess
import sys

from conftest import ROBOTS
import pytest

SOURCE = Path(__file__).resolve().parent.parent
IGNORED = shutil.ignore_patterns('.*', '__pycache__', '*.egg-info', 'build', 'install', 'log',
                                 'demo_output')
EXECUTABLES = ('planner_node', 'fake_hardware_node', 'scenario_player', 'demo', 'reproduce_paper')


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
    for name in ('package.xml', 'launch/demo.launch.py', 'config/robots/paper_2p5r.urdf',
                 'config/robots/panda.yaml', 'config/planner/default.yaml',
                 'config/scenarios/paper.yaml'):
        assert (share / name).is_file(), name
    index = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages'
    assert (index / 'redundant_planner').is_file()


def test_the_installed_nodes_start_from_the_installed_files(workspace):
    """Sourced, from another folder, with the sources out of the way."""
    robot = (workspace / 'install' / 'redundant_planner' / 'share' / 'redundant_planner'
             / 'config' / 'robots' / 'paper_2p5r.yaml')
    assert robot.read_text() == (ROBOTS / 'paper_2p5r.yaml').read_text()
    script = f"""
        source {workspace}/install/setup.bash
        export ROS_DOMAIN_ID=104 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
        export NUMBA_DISABLE_JIT=1  # compiling for yet another place takes half a minute
        lib={workspace}/install/redundant_planner/lib/redundant_planner
        cd / && {sys.executable} -c "import redundant_planner; print(redundant_planner.__file__)"
        for node in fake_hardware_node planner_node; do
            timeout --signal=INT 4 $lib/$node --ros-args --params-file {robot} &
        done
        wait -n; first=$?; wait -n; echo "statuses $first $?"
        """
    done = subprocess.run(['bash', '-c', script], capture_output=True, text=True, timeout=60,
                          check=False)
    assert f'{workspace}/install' in done.stdout, done.stdout
    # timeout gives 124 when it had to interrupt: both nodes were alive until then.
    assert 'statuses 124 124' in done.stdout, done.stdout + done.stderr
    assert "planning for 'paper_2p5r'" in done.stderr, done.stderr
    assert 'Traceback' not in done.stderr, done.stderr

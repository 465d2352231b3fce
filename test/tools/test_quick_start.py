"""quick_start as a new user starts it, and what it does with files that are there."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from conftest import EXAMPLE_ROBOTS, PANDA_URDF, planar_urdf
from live_helpers import children_of, LIVE, PATIENCE, station
import numpy as np
import pytest
from ros_domains import next_domain
import yaml

from benchmark.first_minute import first_minute
from redundant_planner.core.errors import PlannerError
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.robot_files import build_robot, load_robot
from redundant_planner.nodes.child_processes import LiveError
from redundant_planner.nodes.fake_hardware_node import HEARS_COMMANDS
from redundant_planner.tools.quick_start import ARM, main, next_steps, Nodes, prepared
from redundant_planner.tools.show_robot import described_by_urdf

# The end of all processes takes no longer, on a busy machine too [s].
END = 10.0


class Started:
    """quick_start as a process, and what it has said so far."""

    def __init__(self, folder: Path, domain: int, *arguments: str, urdf=PANDA_URDF):
        self._log, self.marker = folder / 'log', f'QUICK_START_TEST={folder}'
        environment = dict(os.environ, ROS_DOMAIN_ID=str(domain), QUICK_START_TEST=str(folder))
        with self._log.open('w') as output:
            self.process = subprocess.Popen(
                [sys.executable, '-m', 'redundant_planner.tools.quick_start', str(urdf),
                 *arguments], env=environment, cwd=folder, stdout=output, stderr=output,
                start_new_session=True)

    @property
    def said(self):
        return self._log.read_text()

    def ended(self):
        """Wait until it and its children have ended; return its exit status."""
        begin = time.monotonic()
        status = self.process.wait(PATIENCE)
        assert time.monotonic() - begin < END
        assert not children_of(self.marker), 'an orphan'
        return status


@pytest.mark.live
@LIVE
def test_the_arm_moves_on_the_first_twist_and_ctrl_c_ends_everything(tmp_path):
    with station() as (ros, _):
        ros.node.destroy_publisher(ros.joint_states)
        domain = ros.node.context.get_domain_id()
        quick = Started(tmp_path, domain)
        try:
            ros.wait_for(lambda: 'Ctrl-C here ends' in quick.said
                         or quick.process.poll() is not None, 'what to type next')
            assert quick.process.poll() is None, quick.said
            assert f'ROS_DOMAIN_ID={domain} ' in quick.said and 'go_to --relative' in quick.said
            assert (tmp_path / 'panda.png').stat().st_size > 50_000
            robot = load_robot(tmp_path / 'panda.yaml')

            def tip():
                return robot.kinematics(ros.state(robot.joint_names)).tip_position

            before = tip()
            ros.drive_until(np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0]),
                            lambda: tip()[2] > before[2] + 0.01, 'motion')
            np.testing.assert_allclose(tip()[:2], before[:2], atol=1e-3)

            # In motion: the last command is a stop.
            ros.drive_until(np.array([0.0, 0.0, -0.05, 0.0, 0.0, 0.0]), ros.moves, 'motion back')
            ros.commands.clear()
            quick.process.send_signal(signal.SIGINT)
            ros.wait_for(lambda: quick.process.poll() is not None, 'the end',
                         meanwhile=ros.driver(np.array([0.0, 0.0, -0.05, 0.0, 0.0, 0.0])))
            assert quick.ended() == 0, quick.said
            ros.wait_for(ros.stops, 'the last word')
            assert 'Traceback' not in quick.said
        finally:
            quick.process.kill()


@pytest.mark.long
@pytest.mark.live
@LIVE
def test_where_an_arm_runs_already_it_does_not_start_another(tmp_path):
    with station() as (ros, _):  # it publishes joint_states
        quick = Started(tmp_path, ros.node.context.get_domain_id())
        try:
            assert quick.ended() == 1
            assert 'runs already in ROS domain' in quick.said and "'station'" in quick.said
        finally:
            quick.process.kill()


@pytest.mark.long
@pytest.mark.live
@LIVE
@pytest.mark.parametrize('urdf, joints, axes', [
    ('kinova_description/robots/kinova.urdf', 6, ('vz', 'vx', 'vy')),
    ('hextilt_description/urdf/hextilt_flying_arm_5.urdf', 5, ('vz', 'vx', 'vy'))])
def test_an_arm_whose_drivers_wrap_and_speak_in_parts_moves_on_the_first_twist(
    urdf, joints, axes,
):
    minute = first_minute(
        EXAMPLE_ROBOTS / urdf, joints, next_domain(), fresh=False, wrapped=True, parts=True)
    assert not minute.problem and minute.axes == axes
    assert min(minute.shares) > 0.9, minute


def test_a_node_that_ends_is_named_with_what_it_said_last(tmp_path, capfd):
    script = tmp_path / 'node.py'
    script.write_text("import sys\nprint('parameter is wrong', file=sys.stderr)\nsys.exit(2)")
    with Nodes(0) as nodes:
        child = nodes.start(script, name='planner_node')
        nodes.check()
        child.wait(PATIENCE)
        with pytest.raises(LiveError, match=(
                r'^planner_node ended with exit status 2; it said last:\n  parameter is wrong$')):
            nodes.check()
    assert 'parameter is wrong' in capfd.readouterr().err


@pytest.mark.parametrize('name, hears', [(ARM, True), ('planner_node', False)])
def test_it_is_known_whether_the_arm_hears_the_planner(tmp_path, name, hears):
    """The planner commands an arm that it has found, which may not have found the planner."""
    script = tmp_path / 'node.py'
    script.write_text(f"print('[INFO] [fake_hardware_node]: {HEARS_COMMANDS}')")
    with Nodes(0) as nodes:
        assert not nodes.arm_hears
        nodes.start(script, name=name).wait(PATIENCE)
        deadline = time.monotonic() + (PATIENCE if hears else 0.2)
        while not nodes.arm_hears and time.monotonic() < deadline:
            time.sleep(0.01)
        assert nodes.arm_hears == hears


def options_for(folder, *, tip='', base='', urdf=PANDA_URDF, overwrite=False):
    return argparse.Namespace(
        urdf=str(urdf), xacro_args=(), out=folder, tip=tip, tips=[], base=base,
        overwrite=overwrite)


@pytest.mark.long
def test_files_that_are_there_are_used_and_not_overwritten(tmp_path):
    said, careful = [], []

    def prepare(**changes):
        said.clear()
        careful.clear()
        return prepared(options_for(tmp_path, **changes), said.append, careful.append)

    arm, file, has_start = prepare()
    assert has_start and not careful
    edited = file.read_text().replace('acceleration_max: [5.0,', 'acceleration_max: [7.0,')
    edited = edited.replace('initial_positions: [', 'initial_positions: [0.125, ', 1)
    edited = edited.replace('initial_joints: [', 'initial_joints: [panda_finger_joint1, ', 1)
    edited = edited.replace('[0.125', '[0.0125')
    file.write_text(edited)
    arm, _, has_start = prepare()
    assert file.read_text() == edited and any('used as it is' in line for line in said)
    assert has_start and arm.robot.acceleration_max[0] == 7.0
    assert arm.start['panda_finger_joint1'] == 0.0125

    # A file of somebody's that says nothing of a start.
    content = yaml.safe_load(edited)
    for name in ('initial_joints', 'initial_positions'):
        del content['/**']['ros__parameters'][name]
    file.write_text(yaml.dump(content))
    os.utime(file, (1, 1))
    arm, _, has_start = prepare()
    assert not has_start and len(arm.start) == 7
    assert any('is newer than' in line for line in careful)

    with pytest.raises(PlannerError, match=r"with the tip 'panda_hand' and not 'panda_link7'"):
        prepare(tip='panda_link7')
    copy = tmp_path / 'other' / 'panda.urdf'
    copy.parent.mkdir()
    copy.write_text(PANDA_URDF.read_text())
    with pytest.raises(PlannerError, match=r'with the URDF .* --out, or --overwrite'):
        prepare(urdf=copy)
    prepare(overwrite=True)
    assert 'acceleration_max: [5.0,' in file.read_text()


@pytest.mark.parametrize(('arguments', 'message'), [
    (['/no/such.urdf'], "'/no/such.urdf' is not a file"),
    ([str(PANDA_URDF), '--tip', 'nose'], "tip_frame 'nose'"),
    ([str(PANDA_URDF), '--out', '/dev/null/here'], 'Not a directory'),
    (['latin.urdf'], 'is not UTF-8 text')])
def test_bad_input_is_one_readable_line(tmp_path, monkeypatch, capfd, arguments, message):
    monkeypatch.setattr(signal, 'signal', lambda number, handler: None)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('ROS_DOMAIN_ID', '89')
    (tmp_path / 'latin.urdf').write_bytes(b'<robot name="\xe9"/>')
    assert main(arguments) == 2
    error = capfd.readouterr().err
    assert error.startswith('quick_start: ') and message in error and error.count('\n') == 1


def test_a_domain_that_is_none_is_refused(monkeypatch, capsys):
    monkeypatch.setattr(signal, 'signal', lambda number, handler: None)
    monkeypatch.setenv('ROS_DOMAIN_ID', 'home')
    assert main([str(PANDA_URDF)]) == 2
    assert "ROS_DOMAIN_ID is 'home'; it must be a number" in capsys.readouterr().err


def test_it_says_what_to_type_with_and_without_the_ros2_command_line():
    both = next_steps(0, *(['ros2', 'run', 'redundant_planner', name] for name in (
        'drive', 'go_to')))
    assert '    ros2 run redundant_planner drive\n' in both
    assert '    ros2 run redundant_planner go_to --relative --position 0.05 0 0 --wait' in both
    without = next_steps(7, ['drive'], ['go_to'])
    assert '    ROS_DOMAIN_ID=7 drive\n' in without
    assert '    ROS_DOMAIN_ID=7 go_to --relative' in without


def test_the_tip_that_it_took_is_said_and_which_links_move_with_it(tmp_path):
    said = []
    prepared(options_for(tmp_path), said.append, said.append)
    assert "tip: 'panda_hand'; --tip steers another link, of the same hand 'panda_link7'" in (
        '\n'.join(said))
    said.clear()
    prepared(options_for(tmp_path, tip='panda_link8', overwrite=True), said.append, said.append)
    assert not any(line.startswith('tip:') for line in said)


def test_axes_that_no_posture_can_follow_are_left_out_and_said(tmp_path):
    urdf, said = tmp_path / 'planar.urdf', []
    urdf.write_text(planar_urdf())
    found = described_by_urdf(str(urdf), '', '', said.append).parameters
    assert found.axes == ('vx', 'vy', 'wz')
    assert len(said) == 1 and "'axes' is vx, vy, wz, and its motion along vz, wx, wy" in said[0]


def test_a_planner_is_warned_of_axes_that_no_posture_can_follow():
    said = []
    given = {'tip_frame': 'tip', 'link_shapes': 'straight'}
    build_robot(RobotParameters(**given), planar_urdf(), {}, warn=said.append)
    assert len(said) == 1 and 'cannot follow every twist of 6 axes' in said[0]
    said.clear()
    build_robot(RobotParameters(**given, axes=('vx', 'vy')), planar_urdf(), {}, warn=said.append)
    assert not said

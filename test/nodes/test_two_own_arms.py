"""Two arms with the files that quick_start writes: they see each other where they are."""

from __future__ import annotations

import argparse

from conftest import EXAMPLE_ROBOTS, PANDA_URDF
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from live_helpers import LIVE, station
import numpy as np
import pytest
from sensor_msgs.msg import JointState
import yaml

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.io.robot_files import load_robot
from redundant_planner.tools.quick_start import prepared

pytestmark = LIVE

UR5_URDF = EXAMPLE_ROBOTS / 'ur_description' / 'urdf' / 'ur5_robot.urdf'
SIDES = ('left', 'right')
OTHER = {'left': 'right', 'right': 'left'}
MARGIN = PlannerParameters().clearance_margin
POSES = {'left': [0.0, 0.0, 0.0], 'right': [1.35, 0.1, 0.0, 0.0, 0.0, 3.0]}


@pytest.fixture
def files(tmp_path, request):
    """Side → quick_start's parameter file."""
    found = {}
    for side, urdf in zip(SIDES, request.param):
        options = argparse.Namespace(
            urdf=str(urdf), xacro_args=(), out=tmp_path / side, tip='', tips=[], base='',
            overwrite=False)
        found[side] = prepared(options, lambda _: None, lambda _: None)[1]
    return found


def started(ros, processes, files, folder, mounts):
    """Start both arms and planners; return what /diagnostics says of each, latest last."""
    said = {side: [] for side in SIDES}

    def on_diagnostics(message):
        for status in message.status:
            for side in SIDES:
                if status.name == f'/{side}/planner_node: planner':
                    said[side].append((status.level, status.message, {
                        pair.key: pair.value for pair in status.values}))

    ros.node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 100)
    both = folder / 'two_arms.yaml'
    both.write_text(yaml.dump({f'/{side}/**': {'ros__parameters': {
        'obstacle_topics': ['/obstacles', f'/{OTHER[side]}/planner_node/body'],
        **({'mount_frame': 'cell', 'mount_pose': POSES[side]} if mounts else {}),
    }} for side in SIDES}))
    for side in SIDES:
        for node in ('fake_hardware_node', 'planner_node'):
            processes.start(node, [files[side], both], {}, {'__ns': f'/{side}'})
    return said


@pytest.mark.parametrize('files', [(PANDA_URDF, UR5_URDF), (PANDA_URDF, PANDA_URDF)],
                         ids=['two kinds', 'twice the same'], indirect=True)
def test_with_mounts_they_see_each_other_at_the_right_distance(files, tmp_path):
    with station() as (ros, processes):
        states = {side: [] for side in SIDES}
        for side in SIDES:
            ros.node.create_subscription(
                JointState, f'/{side}/joint_states', states[side].append, 10)
        said = started(ros, processes, files, tmp_path, mounts=True)

        def sees(side):
            if not said[side] or not states[side]:
                return False
            _, _, values = said[side][-1]
            return values.get('nearest pair', '').partition(' to ')[2].startswith(OTHER[side])

        ros.wait_for(lambda: all(map(sees, SIDES)), 'both see each other')
        motions = []
        for side in SIDES:
            robot = load_robot(files[side], mount_frame='cell', mount_pose=POSES[side])
            message = states[side][-1]
            q = [message.position[message.name.index(name)] for name in robot.joint_names]
            motions.append(Motion.through(capsules_of(robot), np.array([q, q])))
        expected = motions[0].to_other(motions[1]).distance
        assert expected > 0.05
        for side in SIDES:
            level, message, values = said[side][-1]
            assert float(values['nearest distance [m]']) == pytest.approx(expected, abs=1e-3)
            assert float(values['beyond the margin [m]']) == pytest.approx(
                expected - MARGIN, abs=1e-3)
            assert level != DiagnosticStatus.ERROR, message


@pytest.mark.parametrize('files', [(PANDA_URDF, UR5_URDF)], ids=['two kinds'], indirect=True)
def test_without_mounts_both_say_that_they_are_blind(files, tmp_path):
    with station() as (ros, processes):
        said = started(ros, processes, files, tmp_path, mounts=False)
        frames = {'left': 'panda_link0', 'right': 'world'}

        def blind(side):
            return said[side] and said[side][-1][0] == DiagnosticStatus.ERROR and all(
                word in said[side][-1][1] for word in (
                    f'nothing on /{OTHER[side]}/planner_node/body can be used',
                    f"frame '{frames[OTHER[side]]}'"))

        ros.wait_for(lambda: all(map(blind, SIDES)), 'an error of both')

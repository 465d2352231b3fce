"""A planner whose arm is found beyond a range that a parameter narrows."""

from __future__ import annotations

from bench import ARM, ARM_VALUES, FILE
from live_helpers import LIVE, station
import numpy as np
from trajectory_msgs.msg import JointTrajectory

pytestmark = LIVE

JOINT = ARM.joint_names.index('d2')
# It starts at 0.1.
LOW = 0.2


def test_every_output_leads_the_joint_inwards_only():
    with station() as (ros, processes):
        points = []
        ros.node.create_subscription(
            JointTrajectory, 'joint_trajectory', lambda m: points.append(m.points[0].positions),
            1000)
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        processes.start('planner_node', FILE, {
            'position_limits': [f'd2={LOW}..0.4'], 'outputs': ['joint_trajectory']})
        ros.wait_for(lambda: ros.commands and points and ros.twist.get_subscription_count(),
                     'start')
        # Out, which other joints have to do, and in.
        for y in (-0.1, 0.1):
            ros.drive_until(np.array([0.0, y, 0.0, 0.0, 0.0, 0.0]), ros.moves, 'motion')
            ros.drive(np.array([0.0, y, 0.0, 0.0, 0.0, 0.0]), 1.5)
        measured = np.array([m.position[m.name.index('d2')] for m in ros.states])
        commanded = np.array([m.position[m.name.index('d2')] for m in ros.commands])
        ahead = np.array([point[JOINT] for point in points])
    # Of the measured arm, and what it is told; both within what a period at full speed is long.
    for way in (measured, commanded, ahead):
        outside = way[:-1] < LOW
        assert outside.sum() > 100
        assert (np.diff(way)[outside] > -1e-6).all() and np.abs(np.diff(way)).max() < 0.004
    assert measured[-1] > 0.1 + 1e-3

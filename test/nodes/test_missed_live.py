"""A planner that the system holds up tells itself by how much, and records it."""

from __future__ import annotations

import signal
import time

from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from live_helpers import LIVE, station
import numpy as np
import pytest
from std_msgs.msg import Float64MultiArray

from redundant_planner.io.recorded_tick import RecordedTick

pytestmark = LIVE

PANDA = make_panda()
UPWARD = np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])


@pytest.mark.parametrize('outputs, goes_on, most', [
    ([], True, 12), ([], False, 0), (['velocity_commands'], True, 12),
    (['position_commands'], True, 0), (['joint_trajectory'], True, 1)],
    ids=['default', 'by positions', 'velocities', 'positions', 'trajectory'])
def test_ticks_that_were_missed_are_counted(outputs, goes_on, most):
    with station() as (ros, processes):
        ticks = []
        ros.node.create_subscription(
            Float64MultiArray, 'planner_node/ticks',
            lambda message: ticks.append(RecordedTick.of(message.data, PANDA.n)), 1000)
        processes.start('fake_hardware_node', [], {
            'urdf': str(PANDA_URDF), 'initial_joints': list(PANDA.joint_names),
            'initial_positions': list(PANDA_READY)})
        planner = processes.start('planner_node', [ROBOTS / 'panda.yaml'], {
            'urdf': str(PANDA_URDF), 'publish_ticks': True, 'drive.goes_on': goes_on,
            **({'outputs': outputs} if outputs else {})})
        ros.drive_until(UPWARD, lambda: len(ticks) > 100, 'motion')
        for _ in range(5):
            planner.send_signal(signal.SIGSTOP)
            time.sleep(0.04)
            planner.send_signal(signal.SIGCONT)
            ros.drive(UPWARD, 0.2)
        counts = [tick.missed for tick in ticks]
        assert max(counts) <= most
        assert sum(count >= min(most, 5) for count in counts) >= 5

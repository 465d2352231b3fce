"""A Panda behind a controller, in the test's own process: it may be inactive, frozen or mixed up.

It follows the rules of ros2_control's forward_command_controller on mock hardware: a fresh stamp
in every cycle, whatever the hardware does; messages are ignored while it is inactive, and after
it is activated it waits for the next one; numbers go to the joints in its own order; the latest
velocity stays in force, however old.
"""

from __future__ import annotations

import time

from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
import numpy as np
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

PERIOD = 0.004
PANDA = make_panda()
FILE = [ROBOTS / 'panda.yaml']


class ControlledArm:
    """Publishes joint_states and obeys one output; call `cycle` as often as one likes.

    Attributes:
        q: (7,) where it is [rad].
        active: whether the controller is.
        frozen: whether the hardware stands still, as a stopped simulator.
        history: (time, q) of every cycle.
    """

    def __init__(self, ros, output, order=range(7), listens=True):
        self.q, self.active, self.frozen = np.array(PANDA_READY), True, False
        self.history = []
        self._ros, self._output, self._order = ros, output, np.array(order)
        self._told = None
        self._due = time.monotonic()
        if listens:
            ros.node.create_subscription(Float64MultiArray, output, self._hear, 1)

    def _hear(self, message):
        if self.active:
            self._told = np.array(message.data)

    def activate(self, active):
        self.active, self._told = active, None

    def cycle(self):
        now = time.monotonic()
        if now < self._due:
            return
        self._due = max(self._due + PERIOD, now)
        if self._told is not None and not self.frozen:
            told = np.empty(7)
            told[self._order] = self._told
            self.q = told if self._output == 'position_commands' else self.q + PERIOD * told
        self.history.append((now, self.q))
        stamp = Time(nanoseconds=time.time_ns()).to_msg()
        message = JointState(name=list(PANDA.joint_names), position=self.q.tolist())
        message.header.stamp = stamp
        self._ros.joint_states.publish(message)

    def moved(self, since=0.0):
        """How far the farthest joint has been from where it was at a time [rad]."""
        found = np.array([q for at, q in self.history if at >= since])
        return float(np.abs(found - found[0]).max()) if len(found) else 0.0


def started(ros, processes, output, order=range(7), listens=True):
    """Start a planner for an arm; return the arm once the planner commands it."""
    arm = ControlledArm(ros, output, order, listens)
    processes.start('planner_node', FILE, {'urdf': str(PANDA_URDF), 'outputs': [output]})
    ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start',
                 meanwhile=arm.cycle)
    return arm

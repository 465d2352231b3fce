"""planner_node with faults of its own: a message on the topic `fault` names the one to make."""

from __future__ import annotations

import os
import signal
import sys
import time

import numpy as np
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray, String

from redundant_planner.nodes import runtime
from redundant_planner.nodes.last_word import LastWord
from redundant_planner.nodes.planner_node import PlannerNode


class FaultyPlannerNode(PlannerNode):
    """Breaks on demand."""

    def __init__(self, last_word):
        self._times = []
        super().__init__(last_word)
        self._reports_of_times = self.create_publisher(Float64MultiArray, 'command_times', 1)
        self.create_subscription(
            String, 'fault', lambda message: getattr(self, f'break_{message.data}')(), 10)
        publish = self.loop.output.publish

        def publish_and_note(*command):
            publish(*command)
            self._times.append(time.thread_time())

        self.loop.output.publish = publish_and_note

    def break_nothing(self):
        """Say when commands went out since the last time, in processor time of this thread.

        Other work of a busy machine does not count, and a listener may miss commands.
        """
        self._reports_of_times.publish(Float64MultiArray(data=self._times))
        self._times = []

    def break_message(self):
        raise ZeroDivisionError('a bad message')

    def break_executor(self):
        def escape():
            Node.destroy_timer(self, timer)
            raise ZeroDivisionError('outside of every callback of ours')

        timer = Node.create_timer(self, 0.0, escape)

    def break_tick(self):
        def step(*arguments, **more):
            raise ZeroDivisionError('a bad tick')

        self.loop.planner.step = step

    def break_nan(self):
        planner = self.loop.planner
        good = planner.step
        planner.step = lambda *arguments, **more: good(*arguments, **more)._replace(
            dq=np.full(planner.robot.n, np.nan))

    def break_braking(self):
        """Break a tick, and then the braking as well, for a while."""
        self.break_tick()
        good, left = self.loop._stop.next, [3]

        def braked():
            left[0] -= 1
            if left[0] >= 0:
                raise ZeroDivisionError('bad braking')
            return good()

        self.loop._stop.next = braked

    def break_segfault(self):
        os.kill(os.getpid(), signal.SIGSEGV)

    def break_system_exit(self):
        raise SystemExit(3)

    def break_bad_finish(self):
        """Leave in the middle of a motion, without being able to stop."""
        def publish(*arguments):
            raise ZeroDivisionError('nothing goes out any more')

        self.loop.output.publish = publish
        raise SystemExit(4)


if __name__ == '__main__':
    last_word = LastWord.stand_by(None)
    sys.exit(runtime.run(lambda: FaultyPlannerNode(last_word), 'planner_node'))

"""Who else is on the planner's topics: publishers, listeners, and the arm that it waits for."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from redundant_planner.io.tip_topics import OBJECT
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.command_output import NEVER_ENDING
from redundant_planner.nodes.control_loop import ControlLoop
from redundant_planner.nodes.last_word import LastWord, READY, STARTING
from redundant_planner.nodes.other_publishers import publishers_of, why_nothing_comes

# How long the arm may take to say where it is before the log says that it waits [s]: nodes
# announce themselves every 3 s.
_HEARD_WITHIN = 4.0


class TopicWatch:
    """Tells the loop who publishes and who listens, and the log what has become worse."""

    def __init__(
        self, node: Node, loop: ControlLoop, last_word: LastWord, warn: Callable[[str], None],
    ) -> None:
        """Begin with the loop.

        Args:
            node: to ask the ROS graph through.
            loop: that is told.
            last_word: stops the arm should this process die.
            warn: takes a sentence for the log.
        """
        self._node, self._loop, self._last_word, self._warn = node, loop, last_word, warn
        self._began = loop.clock.now()  # [s]
        self._waits_for = ''  # what the log says that it waits for

    def look(self) -> None:
        """See who publishes on this node's topics, who listens, and if its last word is sure."""
        loop, state = self._loop, self._loop.state
        twists = ['cmd_vel'] if isinstance(loop.command, CommandInput) else [
            f'{tip}/cmd_vel' for tip in (*loop.command.tips, OBJECT)]
        loop.supervisor.found_publishers(
            publishers_of(self._node, 'joint_command', has_second=self._last_word.stands_by),
            max((publishers_of(self._node, topic) for topic in twists), key=len))
        state.listeners, before = loop.output.listeners(), state.unheard
        state.unheard = loop.output.unheard()
        if state.unheard not in (before, ''):
            self._warn(state.unheard)
        self._say_what_is_waited_for()
        before = state.last_word
        state.last_word = self._last_word.state(
            sum(state.listeners.get(name, 0) for name in NEVER_ENDING))
        if state.last_word not in (before, READY, STARTING):
            self._warn(f'without a last word: {state.last_word}; if this process died in motion, '
                       'its last command would stand')

    def _say_what_is_waited_for(self) -> None:
        """Say what may keep the arm's joint_states away, and again when that has changed."""
        loop = self._loop
        if loop.supervisor.heard_of_arm or loop.now - self._began < _HEARD_WITHIN:
            return
        waits_for = loop.state.hold if loop.supervisor.heard_of_others else (
            'waiting for joint_states: '
            + why_nothing_comes(self._node, 'joint_states', 'sensor_msgs/msg/JointState'))
        if waits_for != self._waits_for:
            self._node.get_logger().warning(waits_for)
            self._waits_for = waits_for

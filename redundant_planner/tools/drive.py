"""drive: keys of a terminal move the tip of a running planner's arm while they are held.

    w s  forward, back        i k  pitch down, up        + -  faster, slower
    a d  left, right          j l  turn left, right      q    end
    r f  up, down             u o  roll left, right      any other key: stop

Along and about the axes in which the planner takes twists: the base's, unless it is told
otherwise. A terminal does not say when a key is let go, only that it repeats: the arm moves for
0.6 s after a key, and for 0.15 s after one that repeats.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
import os
import select
import sys
import termios
import time
import tty

from geometry_msgs.msg import Twist
import numpy as np
import numpy.typing as npt
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from redundant_planner.core.errors import StateError
from redundant_planner.io.recorded_configuration import configuration_of
from redundant_planner.io.tip_topics import OBJECT, topic_of
from redundant_planner.nodes.runtime import best_executor, keep_off_shared_memory, spin_once

Array = npt.NDArray[np.float64]

# Key → which entry of the twist, and which way.
_MOTIONS = {'w': (0, 1), 's': (0, -1), 'a': (1, 1), 'd': (1, -1), 'r': (2, 1), 'f': (2, -1),
            'u': (3, -1), 'o': (3, 1), 'i': (4, 1), 'k': (4, -1), 'j': (5, 1), 'l': (5, -1)}
# How long a key holds, and one that comes again [s]: keyboards begin to repeat after up to half a
# second, and repeat ten times a second or more.
_FIRST, _REPEATED = 0.6, 0.15
# What + and - change the speed by, and the most that they lead to [m/s].
_STEP, _FASTEST = 1.2, 1.0
# Of rotations to motions: at 0.1 m/s it turns at 0.3 rad/s [rad/m].
_TURNS = 3.0
_PERIOD = 0.02


class Held:
    """What the keys ask for.

    Attributes:
        speed: of the tip [m/s].
    """

    def __init__(self, speed: float) -> None:
        """Begin with no key held, at a speed [m/s]."""
        self.speed = speed
        self._key, self._until = '', 0.0

    def press(self, key: str, now: float) -> None:
        """Take a key at a time [s]."""
        if key in '+=':
            self.speed = min(_STEP * self.speed, _FASTEST)
        elif key == '-':
            self.speed /= _STEP
        elif key in _MOTIONS:
            again = key == self._key and now <= self._until
            self._key, self._until = key, now + (_REPEATED if again else _FIRST)
        else:
            self._key = ''

    def twist(self, now: float) -> Array:
        """Return the twist (6,) at a time [s]: zero where no key is held."""
        twist = np.zeros(6)
        if self._key and now <= self._until:
            axis, way = _MOTIONS[self._key]
            twist[axis] = way * self.speed * (_TURNS if axis > 2 else 1.0)
        return twist


@contextmanager
def _keys_as_they_come(descriptor: int) -> Iterator[None]:
    """Have a terminal hand over keys at once, and not show them."""
    before = termios.tcgetattr(descriptor)
    try:
        tty.setcbreak(descriptor)
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def message_of(twist: Array) -> Twist:
    """Return a twist (6,) as a message."""
    message = Twist()
    parts = (message.linear, message.angular)
    for part, values in zip(parts, (twist[:3], twist[3:])):
        part.x, part.y, part.z = map(float, values)
    return message


class _Output:
    """The topic of a tip's twists: the planner says which, as soon as it is heard."""

    def __init__(self, node: Node, planner: str, tip: str) -> None:
        """Publish for a tip, or for the only one, of a planner's node."""
        self._node, self._tip = node, tip
        self._heard: list[str] | None = []
        self.publisher = node.create_publisher(Twist, f'{tip}/cmd_vel' if tip else 'cmd_vel', 1)
        node.create_subscription(
            String, f'{planner}/configuration', self._on_configuration,
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        self._executor = best_executor(node.context)
        self._executor.add_node(node)

    def _on_configuration(self, message: String) -> None:
        if self._heard is not None:
            self._heard.append(message.data)

    def look(self) -> None:
        """Find out whether the planner has this tip.

        Raises:
            StateError: it does not, or has several of which none is named.
        """
        if self._heard is None:
            return
        spin_once(self._executor, 0.0)
        for text in self._heard:
            self._heard = None
            values = configuration_of(text, [])
            tips = values.get('tips') or [values.get('tip_frame') or self._tip]
            topic = topic_of(self._tip, 'cmd_vel', tips)
            if self._node.resolve_topic_name(topic) != self.publisher.topic_name:
                self.publisher = self._node.create_publisher(Twist, topic, 1)
            break


def _drive(output: _Output, held: Held, descriptor: int) -> None:
    """Publish what the keys ask for until q: twists while one is held, and one zero after it.

    Raises:
        StateError: the planner has no such tip, or several of which none is named.
    """
    moved = False
    try:
        while True:
            ready, _, _ = select.select([descriptor], [], [], _PERIOD)
            output.look()
            now = time.monotonic()
            if ready:
                keys = os.read(descriptor, 64).decode(errors='ignore')
                if not keys or 'q' in keys:
                    break
                held.press(keys[-1], now)
            twist = held.twist(now)
            moves = bool(twist.any())
            if moves or moved:
                output.publisher.publish(message_of(twist))
            if moves != moved or ready:
                heard = output.publisher.get_subscription_count()
                print(f'\r\x1b[K{held.speed:.2f} m/s, {_TURNS * held.speed:.2f} rad/s; '
                      + ('moving' if moves else 'at rest')
                      + ('' if heard else f'; nobody listens to {output.publisher.topic_name}'),
                      end='', flush=True)
            moved = moves
    finally:
        if moved:
            output.publisher.publish(message_of(np.zeros(6)))


def main(args: list[str] | None = None) -> int:
    """Run drive; return the process's exit status."""
    parser = argparse.ArgumentParser(
        prog='drive', description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog='ROS arguments (--ros-args -r __ns:=/left …) may follow.')
    parser.add_argument('--speed', type=float, default=0.1, metavar='M/S',
                        help='to begin with (%(default)s)')
    parser.add_argument('--tip', default='', metavar='NAME',
                        help=f"which of several tips, or '{OBJECT}' for what they hold together")
    parser.add_argument('--planner', default='planner_node',
                        help="name of the planner's node, which knows its tips")
    given = sys.argv[1:] if args is None else args
    ros = given.index('--ros-args') if '--ros-args' in given else len(given)
    options = parser.parse_args(given[:ros])
    if not 0.0 < options.speed <= _FASTEST:
        parser.error(f'--speed is {options.speed}; it must be above 0 and at most {_FASTEST} m/s')
    if not sys.stdin.isatty():
        print('drive: keys come from a terminal, and standard input is none', file=sys.stderr)
        return 2
    keep_off_shared_memory()
    rclpy.init(args=['drive', *given[ros:]], signal_handler_options=SignalHandlerOptions.NO)
    node = Node('drive', enable_rosout=False, start_parameter_services=False)
    try:
        output = _Output(node, options.planner, options.tip)
        print(str(__doc__).split('\n\n')[1])
        with _keys_as_they_come(sys.stdin.fileno()):
            _drive(output, Held(options.speed), sys.stdin.fileno())
    except StateError as error:
        print(f'\ndrive: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        pass
    finally:
        print()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    raise SystemExit(main())

"""record_bag: the planner's topics to an MCAP bag, with or without `ros2 bag`.

It says "recording …" once it hears all that is there: wait for that before you send a command.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from datetime import datetime
import importlib
from pathlib import Path
import signal
import sys
import time
from types import FrameType
from typing import Any

import rclpy
from rclpy.executors import Executor
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import remove_ros_args

from redundant_planner.core.errors import PlannerError
from redundant_planner.io.bag_repair import repair
from redundant_planner.io.bag_writer import BagWriter, message_type_known
from redundant_planner.io.printable import printable
from redundant_planner.io.tip_topics import OBJECT, OBJECT_POSE, OF_TIPS
from redundant_planner.nodes.loop_clock import loop_clock
from redundant_planner.nodes.runtime import best_executor, keep_off_shared_memory

# Relative names, so that a namespace holds; ~ stands for the planner's name.
TOPICS = ('joint_states', 'joint_command', 'cmd_vel', 'cmd_vel_preview', 'target_pose',
          'target_joints', 'target_path', 'target_trajectory', 'obstacles', 'attached',
          'robot_description', '~/configuration', '~/ticks', '~/target', '~/markers',
          '/diagnostics')
_DEPTH = 5000
# How often the recorder looks for topics that have appeared, and hands the system what it has [s].
_LOOK = 0.1
_FLUSH = 1.0
# It is ready once it hears all publishers it knows of, and has found no new topic for this long;
# after the longer time it says so in any case [s].
_SETTLED, _LONGEST_START = 0.5, 5.0
# What had arrived when the recording ends is taken within this time [s].
_LAST = 0.25


class Recorder:
    """Subscribes to topics as they appear and writes whatever comes, as it came."""

    def __init__(self, node: Node, writer: BagWriter, topics: list[str], planner: str) -> None:
        """Look for topics on behalf of a node.

        Args:
            node: to subscribe with.
            writer: an open bag.
            topics: resolved names.
            planner: resolved name of its node, whose tips have topics of their own.
        """
        self.counts: dict[str, int] = {}
        self._node, self._writer, self._topics = node, writer, topics
        self._planner = planner
        self._tips_known = False  # that the planner has no more of them
        self._now_ns = loop_clock(node).stamp_ns
        self._own: list[Subscription] = []

    def look(self) -> bool:
        """Subscribe to the topics that are there by now; return whether there were new ones.

        A topic is there if somebody publishes on it, or hears it and loses nothing: who sends one
        target and is gone would not be heard by a recorder that comes after.
        """
        new = False
        self._look_for_tips()
        for topic in [name for name in self._topics if name not in self.counts]:
            ends = self._node.get_publishers_info_by_topic(topic)
            if not ends:
                ends = self._node.get_subscriptions_info_by_topic(topic)
                if any(end.qos_profile.reliability != ReliabilityPolicy.RELIABLE for end in ends):
                    continue
            if not ends or not message_type_known(ends[0].topic_type):
                continue
            self._subscribe(topic, ends[0].topic_type, [end.qos_profile for end in ends])
            new = True
        return new

    @property
    def has_all(self) -> bool:
        """Whether there is nothing left to look for."""
        return self._tips_known and len(self.counts) == len(self._topics)

    def _look_for_tips(self) -> None:
        """Add what a planner with several tips hears, once it is there."""
        if self._tips_known:
            return
        space, _, name = self._planner.rpartition('/')
        try:
            heard = self._node.get_subscriber_names_and_types_by_node(name, space or '/')
        except NodeNameNonExistentError:
            return
        topics = [topic for topic, _ in heard]
        # One by one they become known: of several tips nothing says which is the last.
        self._tips_known = f'{space}/{OF_TIPS[1]}' in topics
        if f'{space}/{OBJECT}/{OF_TIPS[1]}' in topics:
            own = [topic for topic in topics if topic.startswith(f'{space}/')
                   and topic.removeprefix(f'{space}/').partition('/')[2] in OF_TIPS]
            self._topics += [topic for topic in (*own, f'{space}/{OBJECT_POSE}')
                             if topic not in self._topics]

    def _subscribe(self, topic: str, kind: str, qos: Sequence[QoSProfile]) -> None:
        """Hear a topic as well as all of some qualities of service allow."""
        reliable = all(q.reliability == ReliabilityPolicy.RELIABLE for q in qos)
        latched = all(q.durability == DurabilityPolicy.TRANSIENT_LOCAL for q in qos)
        self.counts[topic] = 0
        self._own.append(self._node.create_subscription(
            _message_class(kind), topic, self._keeper(topic, kind), QoSProfile(
                depth=_DEPTH,
                reliability=ReliabilityPolicy.RELIABLE if reliable
                else ReliabilityPolicy.BEST_EFFORT,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if latched
                else DurabilityPolicy.VOLATILE), raw=True))

    @property
    def hears_all(self) -> bool:
        """Whether every publisher that is known of is heard."""
        return all(own.get_publisher_count() >= self._node.count_publishers(own.topic_name)
                   for own in self._own)

    def _keeper(self, topic: str, kind: str) -> Callable[[bytes], None]:
        def keep(message: bytes) -> None:
            if not self.counts[topic]:
                self._writer.add_topic(topic, kind)
            self.counts[topic] += 1
            self._writer.write(topic, self._now_ns(), message)
        return keep


def _message_class(kind: str) -> Any:
    package, _, name = kind.split('/')
    return getattr(importlib.import_module(f'{package}.msg'), name)


def _heard(recorder: Recorder) -> str:
    count = len(recorder.counts)
    found = 'none of its topics is' if not count else (
        '1 topic is' if count == 1 else f'{count} topics are')
    return f'{found} there yet; others are recorded from when they appear'


def _take_the_last(executor: Executor, recorder: Recorder) -> None:
    """Write what had arrived when the recording was to end."""
    end, before = time.monotonic() + _LAST, -1
    while time.monotonic() < end and before != sum(recorder.counts.values()):
        before = sum(recorder.counts.values())
        executor.spin_once(timeout_sec=_LAST / 5)


def record(folder: Path, planner: str, extra: list[str], duration: float | None) -> dict[str, int]:
    """Record until interrupted, or for a while once it is ready; return topic → its messages.

    Args:
        folder: of the new bag.
        planner: name of the planner's node.
        extra: further topics.
        duration: [s], None for no end.

    Raises:
        RecordingError: the folder exists already.
    """
    stopped = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    node = Node('record_bag', enable_rosout=False, start_parameter_services=False)
    executor = best_executor(node.context)
    executor.add_node(node)
    names = [node.resolve_topic_name(topic.replace('~', planner)) for topic in (*TOPICS, *extra)]
    try:
        with BagWriter(folder) as writer:
            recorder = Recorder(node, writer, names, node.resolve_topic_name(planner))
            begin = found = time.monotonic()
            looked, flushed, ready = -_LOOK, begin, False
            while not stopped:
                now = time.monotonic()
                if ready and duration is not None and now - begin >= duration:
                    break
                if now - looked >= _LOOK and not recorder.has_all:
                    found = now if recorder.look() else found
                    looked = now
                if not ready and (now - begin > _LONGEST_START or (
                        recorder.counts and now - found > _SETTLED and recorder.hears_all)):
                    ready, begin = True, now
                    print(f"recording to '{folder}' until Ctrl-C: {_heard(recorder)}", flush=True)
                if now - flushed >= _FLUSH:
                    writer.flush()
                    flushed = now
                executor.spin_once(timeout_sec=_LOOK)
            _take_the_last(executor, recorder)
    finally:
        node.destroy_node()
    return recorder.counts


def main(args: list[str] | None = None) -> int:
    """Run record_bag; return the process's exit status."""
    parser = argparse.ArgumentParser(
        prog='record_bag', description=__doc__,
        epilog='ROS arguments may follow: --ros-args -r __ns:=/left, or -p use_sim_time:=true '
               'for times by /clock.')
    parser.add_argument('bag', nargs='?', type=Path, help='folder to write')
    parser.add_argument('--planner', default='planner_node', help="name of the planner's node")
    parser.add_argument('--topics', nargs='+', default=[], help='further topics')
    parser.add_argument('--duration', type=float, metavar='SECONDS')
    parser.add_argument('--repair', type=Path, metavar='BAG',
                        help='close a bag whose recorder was killed, and do nothing else')
    given = sys.argv if args is None else ['record_bag', *args]
    options = parser.parse_args(remove_ros_args(given)[1:])
    try:
        if options.repair is not None:
            done = repair(options.repair)
            print('\n'.join(done) or f"'{options.repair}' was closed properly")
            return 0
        folder = options.bag or Path(datetime.now().strftime('bag_%Y_%m_%d-%H_%M_%S'))
        keep_off_shared_memory()
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
        counts = record(folder, options.planner, options.topics, options.duration)
    except (PlannerError, OSError) as error:
        print(f'record_bag: {printable(str(error))}', file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    for topic, count in counts.items():
        if count:
            print(f'{count:8d}  {topic}')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())

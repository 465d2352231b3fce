"""A scenario played live: every node a process of its own, the traffic recorded to a bag."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
import os
from pathlib import Path
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from redundant_planner.io.bag_writer import BagWriter
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.scenario import Scenario
from redundant_planner.nodes import physics_report
from redundant_planner.nodes.child_processes import cpu_seconds, LiveError, Processes
from redundant_planner.nodes.messages import NANOSECONDS
from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.nodes.runtime import keep_off_shared_memory

_TOPICS = {
    'joint_states': (JointState, 'sensor_msgs/msg/JointState'),
    'joint_command': (JointState, 'sensor_msgs/msg/JointState'),
    'cmd_vel': (Twist, 'geometry_msgs/msg/Twist'),
    'cmd_vel_preview': (
        MultiDOFJointTrajectory, 'trajectory_msgs/msg/MultiDOFJointTrajectory'),
    'obstacles': (MarkerArray, 'visualization_msgs/msg/MarkerArray'),
    # What the test camera sees, in a bag beside what the planner knows.
    'camera_obstacles': (MarkerArray, 'visualization_msgs/msg/MarkerArray'),
    'robot_description': (String, 'std_msgs/msg/String'),
    'planner_node/configuration': (String, 'std_msgs/msg/String'),
    'planner_node/ticks': (Float64MultiArray, 'std_msgs/msg/Float64MultiArray'),
    'diagnostics': (DiagnosticArray, 'diagnostic_msgs/msg/DiagnosticArray'),
}
_CLOCK = '/clock'
# Of an arm with mass besides.
_CONTACTS = 'mujoco_hardware_node/contacts'
_LATCHED = (_CONTACTS, 'robot_description', 'planner_node/configuration', 'planner_node/ticks')
# How long processes get to start, on a busy machine too [s].
_START_PATIENCE = 120.0
# How long the arm's process may draw a film after the motion [s].
_FILM_PATIENCE = 300.0
# How long a simulated arm waits for an answer [s].
_ANSWER_PATIENCE = 30.0
# How often what has come is recorded [s].
_LOOK = 0.02


@dataclass(frozen=True)
class LiveRun:
    """What a live run leaves besides its bag.

    Attributes:
        bag: the bag's folder.
        planner_cpu: share of one core that the planner's process used during the motion.
        physics: what an arm with mass last said of itself in /diagnostics; empty for an ideal one.
    """

    bag: Path
    planner_cpu: float
    physics: Mapping[str, str] = field(default_factory=dict)


def play(
    scenario: Scenario, scenario_file: Path, bag: Path, *, planner_files: Sequence[Path] = (),
    planner_values: Mapping[str, object] | None = None, camera_files: Sequence[Path] = (),
    domain_id: int | None = None, kind: type[Processes] = Processes,
    physics: Sequence[str] | None = None, simulated_time: bool = False,
) -> LiveRun:
    """Play a scenario through planner_node and a simulated arm and record it.

    Args:
        scenario: the scenario, as loaded from
        scenario_file: its file.
        bag: folder to write, must not exist.
        planner_files: parameter files for the planner besides the robot's.
        planner_values: single parameters; 'urdf' goes to the other nodes as well.
        camera_files: parameter files for depth_camera and cloud_obstacles besides the robot's; if
            there are any, the scenario's obstacles are shown to the camera alone.
        domain_id: ROS domain; one derived from the process number if not given.
        kind: of processes the nodes are.
        physics: options of mujoco_hardware_node, which is the arm then; None for
            fake_hardware_node.
        simulated_time: whether the arm sets the pace, and waits for planner and player in each
            of its periods: what is recorded then does not depend on how busy the machine is.

    Raises:
        LiveError: a process failed or the motion did not end in time.
    """
    domain_id = 1 + os.getpid() % 100 if domain_id is None else domain_id
    values = _values_of(scenario, planner_values or {}, simulated_time=simulated_time)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    keep_off_shared_memory()
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    try:
        with kind(domain_id) as processes, BagWriter(bag) as writer:
            node = Node('recorder', context=context, enable_rosout=False,
                        start_parameter_services=False)
            recorder = _Recorder(
                node, writer, () if physics is None else (_CONTACTS,), simulated_time)
            hardware = processes.start(
                'fake_hardware_node' if physics is None else 'mujoco_hardware_node',
                [scenario.robot_file], values.arm, options=physics or ())
            for name in ('depth_camera', 'cloud_obstacles') if camera_files else ():
                processes.start(name, [scenario.robot_file, *camera_files], values.camera)
            planner = processes.start(
                'planner_node', [scenario.robot_file, *planner_files], values.planner)
            _wait_until(lambda: 'joint_command' in recorder.seen, processes, recorder,
                        _START_PATIENCE, 'no joint_command was published')
            if camera_files:
                _wait_until(lambda: 'obstacles' in recorder.seen, processes, recorder,
                            _START_PATIENCE, 'cloud_obstacles published nothing')
            player = processes.start(
                'scenario_player',
                values={'scenario': scenario_file, 'subscribers': 2, **values.player},
                remap={'obstacles': 'camera_obstacles'} if camera_files else None)
            _wait_until(lambda: 'cmd_vel' in recorder.seen, processes, recorder,
                        _START_PATIENCE, 'no cmd_vel was published')
            begin, used = time.monotonic(), cpu_seconds(planner.pid)
            _wait_until(lambda: player.poll() is not None, processes, recorder,
                        scenario.duration + _START_PATIENCE, 'the player did not end')
            share = (cpu_seconds(planner.pid) - used) / (time.monotonic() - begin)
            recorder.record()
            if physics:  # the planner first, which would miss the arm
                processes.end(planner, _FILM_PATIENCE)
                processes.end(hardware, _FILM_PATIENCE)
            node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    return LiveRun(bag, share, recorder.physics)


class _Values(NamedTuple):
    """Parameters of each node, besides those of files.

    Attributes:
        arm, camera, planner, player: name → value; the camera's are for what reads it, too.
    """

    arm: dict[str, object]
    camera: dict[str, object]
    planner: dict[str, object]
    player: dict[str, object]


def _values_of(
    scenario: Scenario, planner_values: Mapping[str, object], *, simulated_time: bool,
) -> _Values:
    """Return the parameters of the nodes that play a scenario; for arguments see `play`."""
    arm: dict[str, object] = {'initial_joints': list(scenario.start),
                              'initial_positions': list(scenario.start.values())}
    common = {'urdf': planner_values['urdf']} if 'urdf' in planner_values else {}
    pace: dict[str, object] = {}
    if simulated_time:
        common['use_sim_time'] = True
        # A sender that is waited for in every period has to speak in every period.
        pace['rate'] = planner_values.get('rate', PlannerNodeParameters().rate)
        arm |= {'clock': True, 'wait_for_cmd_vel': True, 'answer_timeout': _ANSWER_PATIENCE,
                'real_time_factor': 1.0}
    return _Values({**arm, **common, **pace}, common, {**common, **planner_values},
                   {**common, **pace})


def _wait_until(
    done: Callable[[], bool], processes: Processes, recorder: _Recorder, patience: float,
    what: str,
) -> None:
    """Record until something is done.

    Args:
        done: whether it is.
        processes: must not fail meanwhile.
        recorder: writes what comes.
        patience: how long to wait [s].
        what: did not happen, for the message.

    Raises:
        LiveError: a process failed, or it took too long.
    """
    deadline = time.monotonic() + patience
    while not done():
        processes.check()
        if time.monotonic() > deadline:
            raise LiveError(f'{what} within {patience:g} s')
        time.sleep(_LOOK)
        recorder.record()


class _Recorder:
    """Writes every message of the package's topics to a bag, with the time of its publication.

    Unlike that of its arrival, it does not depend on whether this process is awake. Where an arm
    sets the pace, it is simulated time.

    Attributes:
        seen: topics of which there was a message.
        physics: the latest entry of an arm with mass in /diagnostics.
    """

    def __init__(
        self, node: Node, writer: BagWriter, reports: Sequence[str], simulated_time: bool,
    ) -> None:
        """Subscribe on a node, to topics of reports and to /clock besides."""
        self.seen: set[str] = set()
        self.physics: dict[str, str] = {}
        self._writer = writer
        self._inboxes = {}
        for topic, (message_class, message_type) in (
                _TOPICS | dict.fromkeys(reports, _TOPICS['diagnostics'])).items():
            writer.add_topic(f'/{topic}', message_type)
            self._inboxes[topic] = PolledSubscription(node, message_class, topic, QoSProfile(
                depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL if topic in _LATCHED
                else DurabilityPolicy.VOLATILE))
        if simulated_time:
            self._inboxes[_CLOCK] = PolledSubscription(node, Clock, _CLOCK, QoSProfile(depth=1000))
        self._simulated: int | None = 0 if simulated_time else None

    def record(self) -> None:
        """Write what has come since the last call."""
        messages = [(time_ns, topic, message) for topic, inbox in self._inboxes.items()
                    for message, time_ns in inbox.fetch_stamped()]
        for time_ns, topic, message in sorted(messages, key=itemgetter(0)):
            if topic == _CLOCK:
                clock = deserialize_message(message, Clock).clock
                self._simulated = clock.sec * NANOSECONDS + clock.nanosec
                continue
            self.seen.add(topic)
            if topic == 'diagnostics':
                self.physics = physics_report.read_state(
                    deserialize_message(message, DiagnosticArray)) or self.physics
            self._writer.write(
                f'/{topic}', time_ns if self._simulated is None else self._simulated, message)

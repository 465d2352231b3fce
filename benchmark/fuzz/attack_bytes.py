"""Damaged messages: joint_states, obstacles, payload, previews, commands and chunks, then a tick.

Valid messages of many kinds are mutated (bits, bytes, words that become huge counts or special
numbers, cuts, splices, another encoding) and read one after another by the same readers, as in a
node. What they let through goes into a planner in motion.
"""

from __future__ import annotations

from functools import cache
import pathlib
from typing import Any

from geometry_msgs.msg import Point, PoseStamped, Transform, Twist, TwistStamped
from nav_msgs.msg import Path
import numpy as np
import numpy.typing as npt
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA
from trajectory_msgs.msg import (
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
)
from visualization_msgs.msg import Marker, MarkerArray

from benchmark.fuzz.tally import Tally
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.obstacle_tracker import ObstacleTracker
from redundant_planner.io.payload import Payload
from redundant_planner.io.resources import share_directory
from redundant_planner.io.robot_files import load_robot
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.joint_messages import JointReader

Array = npt.NDArray[np.float64]
Random = np.random.Generator

DT = 0.004
MESSAGES, TICKS = 150, 4
START = np.array([0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0])
COUNTS = (0, 1, 2, 255, 256, 1000, 20_000, 2**16, 2**28, 2**31 - 1, 2**31, 2**32 - 1)
NUMBERS = (0.0, -0.0, 1e-320, 2e-162, 1e-9, 1e-6, 1.0, -1.0, 1e3, 1e6, 1e154, 1e300, -1e308,
           np.inf, -np.inf, np.nan)
NAMES = ('', 'base', 'o', 'a name', 'tool', 'ü\n\x1b[31m', 'n' * 255, 'n' * 256, '../..', '%s')


@cache
def paper_arm() -> Robot:
    """Return the arm whose planner is attacked."""
    return load_robot(share_directory() / 'config' / 'robots' / 'paper_2p5r.yaml')


def attack(random: Random, folder: pathlib.Path, tally: Tally) -> None:
    """Send one sequence of damaged messages to the readers of one node."""
    robot = paper_arm()
    sentences: list[str] = []
    clock = [100.0]
    command = CommandInput(
        {robot.base_frame: 'base', robot.tip_frame: 'tool'}, 'base', lambda: clock[0],
        lambda: 1e9 + clock[0], sentences.append)
    book = ObstacleTracker((), ['', robot.base_frame], transform=lambda frame: (
        np.array([0.1, 0.0, 0.0]), np.eye(3)), estimate_velocity=True)
    joints = JointReader(robot.joint_names)
    planner, q, dq = Planner(robot, PlannerParameters(
        method=random.choice(['dynamic_factor', 'variational']))), START.copy(), np.zeros(robot.n)
    payload = Payload(robot)

    def attach(raw: bytes) -> list[str]:
        problems = payload.tracker.update(raw, clock[0])
        things = payload.changed()
        if things is not None:
            planner.hold(things)
            book.hidden = payload.names
        return problems

    def measured(raw: bytes) -> Array:
        which = joints.read(raw)
        return joints.posture[which]

    takers = {
        'attached': attach, 'joint_states': measured,
        'obstacles': lambda raw: book.update(raw, clock[0]), 'cmd_vel': command.on_twist,
        'stamped': command.on_twist_stamped, 'preview': command.on_preview,
        'target': command.on_target,
        'joint_target': lambda raw: command.on_joint_target(raw, robot, q),
        'path': command.on_path,
        'trajectory': lambda raw: command.on_trajectory(raw, robot, q)}
    makers = {'attached': marker_array, 'joint_states': joint_state, 'obstacles': marker_array,
              'cmd_vel': twist, 'stamped': stamped_twist, 'preview': preview,
              'target': target_pose, 'joint_target': target_joints, 'path': target_path,
              'trajectory': target_trajectory}
    earlier: list[bytes] = [b'']
    for number in range(MESSAGES):
        topic = str(random.choice(list(takers)))
        raw = bytes(serialize_message(makers[topic](random, robot)))
        if random.random() < 0.7:
            raw = damaged(random, raw, earlier[int(random.integers(len(earlier)))])
        earlier = [*earlier[-9:], raw]
        answer = tally.attempt(lambda: takers[topic](raw))  # noqa: B023
        if topic == 'joint_states' and answer is not None:
            tally.check_finite(answer)
        refused = (len(answer) if topic in ('attached', 'obstacles') and answer
                   else len(sentences))
        tally.refusals += bool(refused)
        sentences.clear()
        clock[0] += float(random.choice([0.001, 0.02, 0.4]))
        if number % (MESSAGES // TICKS) == 0:
            q, dq = _ticks(tally, planner, command, book, q, dq, clock)


def _ticks(
    tally: Tally, planner: Planner, command: CommandInput, book: ObstacleTracker, q: Array,
    dq: Array, clock: list[float],
) -> tuple[Array, Array]:
    """Let the planner act on what came through; return where the arm is, and its velocity."""
    robot = planner.robot
    for _ in range(3):
        book.expire(clock[0])
        scene = book.scene
        tally.check_finite(scene.centers, scene.rotations, scene.half_extents, scene.velocities)
        tips = robot.kinematics(q).tips
        result = tally.attempt(lambda: planner.step(
            q, command.twist(10.0, lambda: tips), book.scene, DT,  # noqa: B023
            command.ahead(10.0),
            command.target(planner.references or tips)))  # noqa: B023
        if result is None or not tally.check_finite(result.dq):
            planner.reset()
            return START.copy(), np.zeros(robot.n)
        fast = np.abs(result.dq) > robot.velocity_max * (1.0 + 1e-6)
        hard = np.abs(result.dq - dq) > robot.acceleration_max * DT * (1.0 + 1e-6) + 1e-9
        tally.limit_violations += bool(fast.any() or hard.any())
        dq = result.dq
        q = q + DT * dq
        clock[0] += DT
    return q, dq


def _number(random: Random, size: float = 1.0) -> float:
    """Return an ordinary number, mostly."""
    return float(random.choice(NUMBERS)) if random.random() < 0.05 else float(
        random.normal(0.0, size))


def _fill(random: Random, vector: Any, size: float) -> None:
    for axis in vector.get_fields_and_field_types():
        setattr(vector, axis, _number(random, size))


def _head(random: Random, header: Any) -> None:
    header.frame_id = str(random.choice(NAMES)) if random.random() < 0.3 else ''
    if random.random() < 0.5:
        header.stamp.sec = int(random.choice([0, -1, 10**9 + 100, -2**31, 2**31 - 1]))
        header.stamp.nanosec = int(random.choice([0, 1, 2, 10**9 - 1, 2**32 - 1]))


def joint_state(random: Random, robot: Robot) -> JointState:
    """Return joint states in some order, now and then incomplete."""
    names = [str(name) for name in random.permutation([*robot.joint_names, 'finger'])]
    if random.random() < 0.2:
        names = names[1:] + names[:int(random.integers(2))]
    message = JointState(name=names, position=[_number(random) for _ in names])
    _head(random, message.header)
    if random.random() < 0.5:
        message.velocity = [_number(random) for _ in names[int(random.integers(2)):]]
    return message


def target_joints(random: Random, robot: Robot) -> JointState:
    """Return where some joints shall go, mostly within their limits."""
    count = int(random.integers(0, robot.n + 1))
    chosen = random.permutation(robot.n)[:count]
    low, high = (np.nan_to_num(end, posinf=3.0, neginf=-3.0)
                 for end in (robot.position_min, robot.position_max))
    message = JointState(
        name=[robot.joint_names[j] for j in chosen],
        position=[_number(random) if random.random() < 0.1 else float(
            random.uniform(low[j], high[j])) for j in chosen])
    _head(random, message.header)
    return message


def marker_array(random: Random, robot: Robot) -> MarkerArray:
    """Return markers of all kinds, often in one layout, now and then none or very many."""
    count = int(random.choice([0, 1, 2, 5, 30, 300], p=[0.2, 0.2, 0.2, 0.2, 0.15, 0.05]))
    same = random.random() < 0.6
    message = MarkerArray()
    for i in range(count):
        odd = not same and random.random() < 0.5
        marker = Marker(
            ns=str(random.choice(NAMES)) if odd else 'o',
            id=int(random.integers(5)) if odd else i,
            type=int(random.integers(-1, 12)) if odd else int(random.choice([1, 2, 3])),
            action=int(random.choice([0, 0, 0, 1, 2, 3, 7])) if odd else 0)
        if odd:
            _head(random, marker.header)
            marker.points = [Point()] * int(random.integers(4))
            marker.colors = [ColorRGBA()] * int(random.integers(4))
            marker.text = str(random.choice(NAMES))
            marker.lifetime.sec = int(random.choice([0, 0, 1, -1, 2**31 - 1, -2**31]))
        _fill(random, marker.pose.position, 0.5)
        marker.pose.orientation.w = 1.0 if random.random() < 0.95 else _number(random)
        _fill(random, marker.scale, 0.1)
        marker.scale.x, marker.scale.y, marker.scale.z = (
            abs(value) for value in (marker.scale.x, marker.scale.y, marker.scale.z))
        message.markers.append(marker)
    return message


def twist(random: Random, robot: Robot) -> Twist:
    """Return a twist."""
    message = Twist()
    _fill(random, message.linear, 0.1)
    _fill(random, message.angular, 0.1)
    return message


def stamped_twist(random: Random, robot: Robot) -> TwistStamped:
    """Return a twist with a header."""
    message = TwistStamped(twist=twist(random, robot))
    _head(random, message.header)
    return message


def target_pose(random: Random, robot: Robot) -> PoseStamped:
    """Return a target near the arm, mostly."""
    message = PoseStamped()
    _head(random, message.header)
    _fill(random, message.pose.position, 1.0)
    quaternion = random.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    for axis, value in zip('xyzw', quaternion):
        setattr(message.pose.orientation, axis, float(value))
    if random.random() < 0.1:
        _fill(random, message.pose.orientation, 1.0)
    return message


def target_path(random: Random, robot: Robot) -> Path:
    """Return a path of poses near the arm, mostly with stamps that ascend."""
    message = Path()
    _head(random, message.header)
    odd = random.random() < 0.3
    for i in range(int(random.choice([0, 1, 2, 20]))):
        pose = target_pose(random, robot)
        pose.header.frame_id = pose.header.frame_id if odd else message.header.frame_id
        if not odd:
            pose.header.stamp.sec, pose.header.stamp.nanosec = 10**9 + 101, 40_000_000 * i
        message.poses.append(pose)
    return message


def target_trajectory(random: Random, robot: Robot) -> JointTrajectory:
    """Return a trajectory of some joints, mostly within their limits, with times that ascend."""
    first = target_joints(random, robot)
    message = JointTrajectory(header=first.header, joint_names=first.name)
    odd = random.random() < 0.3
    for i in range(int(random.choice([0, 1, 2, 20]))):
        point = JointTrajectoryPoint(positions=[
            position + _number(random, 0.01) for position in first.position])
        if odd:
            point.velocities = [_number(random)] * int(random.integers(9))
            point.effort = [_number(random)] * int(random.integers(3))
        point.time_from_start.nanosec = int(random.integers(2**32)) if odd else 40_000_000 * i
        message.points.append(point)
    return message


def preview(random: Random, robot: Robot) -> MultiDOFJointTrajectory:
    """Return a preview, mostly of uniform points with times that ascend."""
    message = MultiDOFJointTrajectory()
    _head(random, message.header)
    odd = random.random() < 0.3
    for i in range(int(random.choice([0, 1, 2, 20]))):
        point = MultiDOFJointTrajectoryPoint(
            velocities=[twist(random, robot)] * (int(random.integers(3)) if odd else 1),
            transforms=[Transform()] * (int(random.integers(3)) if odd else 0))
        point.time_from_start.sec = int(random.integers(-2, 5)) if odd else i
        message.points.append(point)
    return message


def damaged(random: Random, raw: bytes, other: bytes) -> bytes:
    """Return a message after one to four mutations."""
    changed = bytearray(raw)
    for _ in range(int(random.integers(1, 5))):
        at = int(random.integers(len(changed))) if changed else 0
        kind = random.choice(['bit', 'byte', 'count', 'number', 'cut', 'more', 'splice', 'head',
                              'empty'], p=[0.15, 0.1, 0.25, 0.2, 0.1, 0.05, 0.07, 0.06, 0.02])
        if kind in ('bit', 'byte') and changed:
            changed[at] ^= 1 << int(random.integers(8)) if kind == 'bit' else int(
                random.integers(256))
        elif kind == 'count':
            at -= at % 4
            changed[at:at + 4] = int(random.choice(COUNTS)).to_bytes(
                4, str(random.choice(['little', 'little', 'big'])))  # type: ignore[arg-type]
        elif kind == 'number':
            at = 4 + (at - at % 8)
            changed[at:at + 8] = np.array(random.choice(NUMBERS), '<f8').tobytes()
        elif kind == 'cut':
            del changed[at:]
        elif kind == 'more':
            changed += random.bytes(int(random.integers(64)))
        elif kind == 'splice':
            changed[at:] = other[int(random.integers(len(other) + 1)):]
        elif kind == 'head':
            changed[:2] = random.choice([b'\0\0', b'\0\1', b'\0\2', b'\0\3', b'\0\7', b'\1\1'])
        else:
            changed.clear()
    return bytes(changed)

"""Who drives an arm with joints without end in every way, for `benchmark.seams`."""

from __future__ import annotations

from collections.abc import Callable
import time

from geometry_msgs.msg import PoseStamped, Twist
import numpy as np
import numpy.typing as npt
from rcl_interfaces.msg import Log
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.robot.turns import TURN
from redundant_planner.nodes.messages import markers_of, positions_from_message, twist_to_message
from redundant_planner.nodes.pose_messages import pose_to_message
from redundant_planner.nodes.runtime import best_executor

Array = npt.NDArray[np.float64]

# Where the arm stands between motions, far from singularities, and of the first joint how far to
# the sides the poses behind the obstacle are [rad].
HOME = np.array([np.pi, 2.892, 5.091, np.pi, 1.035, np.pi])
_SIDE = 0.5
# The obstacle's radius [m], half way between those poses.
_BALL = 0.05
# How often commands come [Hz], for how long each [s], and how far to and fro joints go [rad].
_RATE, _LASTS, _SWING = 50.0, 4.2, 0.25
# Of its velocity limit a joint turns with as much by twists; to and fro it turns for so long [s].
_SHARE, _TURNS_FOR = 0.95, 1.0
# Half a period of streams, which the slowest joint can follow [s].
_HALF = 1.4
# A target is reached if no joint, or the tip, is further from it [rad, m], and all are slower
# [rad/s]. It takes no longer than this [s].
_REACHED, _AT_REST, _PATIENCE = 5e-3, 2e-3, 20.0
# Level of a log's warnings.
_WARNING = 30


class Operator:
    """Commands the arm in every way, and waits for what becomes of it.

    Attributes:
        said: the log's warnings.
        segments: kind of command → how often.
        missed: kinds of command whose target was not reached in time.
    """

    def __init__(self, context: Context, robot: Robot) -> None:
        """Join the planner's network."""
        self.said: list[str] = []
        self.segments: dict[str, int] = {}
        self.missed: list[str] = []
        self._robot = robot
        self._endless = np.flatnonzero(np.isinf(robot.position_max)).tolist()
        self._sign = 1.0  # of the next turn
        self._q, self._dq, self._commands = np.full(robot.n, np.nan), np.zeros(robot.n), 0
        self._node = Node('operator', context=context, enable_rosout=False)
        self._executor = best_executor(context)
        self._executor.add_node(self._node)
        self._twist = self._node.create_publisher(Twist, 'cmd_vel', 10)
        self._joints = self._node.create_publisher(JointState, 'target_joints', 10)
        self._pose = self._node.create_publisher(PoseStamped, 'target_pose', 10)
        self._obstacles = self._node.create_publisher(MarkerArray, 'obstacles', 10)
        self._node.create_subscription(JointState, 'joint_states', self._on_states, 10)
        self._node.create_subscription(JointState, 'joint_command', self._on_command, 10)
        self._node.create_subscription(Log, '/rosout', self._on_log, 100)

    def _on_states(self, message: JointState) -> None:
        self._q = positions_from_message(message, self._robot.joint_names)

    def _on_command(self, message: JointState) -> None:
        self._dq, self._commands = np.array(message.velocity), self._commands + 1

    def _on_log(self, message: Log) -> None:
        if message.level >= _WARNING:
            self.said.append(message.msg)

    def spin(self, seconds: float = 0.01) -> None:
        """Listen for a while [s]."""
        until = time.monotonic() + seconds
        while (rest := until - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=rest)

    @property
    def is_ready(self) -> bool:
        """Whether the planner commands the arm, and hears all commands."""
        return bool(self._commands) and np.isfinite(self._q).all() and all(
            publisher.get_subscription_count() >= 2  # planner and recorder
            for publisher in (self._twist, self._joints, self._pose, self._obstacles))

    def command(self, until: float) -> None:
        """Command the arm in every way, in turn, until a time of the monotonic clock is over [s].

        The last round is finished.
        """
        kinds: dict[str, Callable[[], None]] = {
            'joint targets': self._to_joints, 'twists': self._turn,
            'a stream of poses': lambda: self._stream(self._send_pose),
            'a stream of joint positions': lambda: self._stream(self._send_joints),
            'free ways': self._around}
        self._reach('the first posture', HOME)
        while time.monotonic() < until:
            for kind, do in kinds.items():
                do()
                self._reach(kind, HOME)
                self.segments[kind] = self.segments.get(kind, 0) + 1

    def _send_joints(self, q: Array) -> None:
        self._joints.publish(JointState(name=self._robot.joint_names, position=q.tolist()))

    def _send_pose(self, q: Array) -> None:
        """Send the pose of the tip at a posture (n,)."""
        arm = self._robot.kinematics(q)
        self._pose.publish(pose_to_message(
            Pose(arm.tip_position, arm.tip_rotation), self._robot.base_frame))

    def _swung(self, by: float) -> Array:
        """Return the home posture (n,) with all joints without end turned [rad]."""
        q = HOME.copy()
        q[self._endless] += by
        return q

    def _reach(self, kind: str, q: Array) -> None:
        """Go to joint positions (n,)."""
        self._send_joints(q)
        self._arrive(kind, lambda: float(np.abs(np.where(
            np.isinf(self._robot.position_max), 2.0 * np.sin(0.5 * (self._q - q)),
            self._q - q)).max()))

    def _arrive(self, kind: str, off: Callable[[], float]) -> None:
        """Wait until the arm is at rest where it is told to go, or for too long."""
        deadline = time.monotonic() + _PATIENCE
        while off() > _REACHED or np.abs(self._dq).max() > _AT_REST:
            if time.monotonic() > deadline:
                self.missed.append(kind)
                return
            self.spin()

    def _to_joints(self) -> None:
        for by in (_SWING, -_SWING, _SWING, -_SWING):
            self._reach('joint targets', self._swung(by))

    def _turn(self) -> None:
        """Turn joint by joint by twists: to and fro, the last one all around besides."""
        self._sign = -self._sign
        for joint in self._endless:
            for sign, share in ((1.0, 0.5), (-1.0, 1.0), (1.0, 0.5)):
                self._twist_of(joint, sign, share * _TURNS_FOR)
        last = self._endless[-1]
        self._twist_of(last, self._sign, TURN / (_SHARE * self._robot.velocity_max[last]))
        while np.abs(self._dq).max() > _AT_REST:
            self.spin()

    def _twist_of(self, joint: int, sign: float, seconds: float) -> None:
        """Send the twist that one joint alone makes, for a while [s]."""
        rate = sign * _SHARE * self._robot.velocity_max[joint]
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self._twist.publish(twist_to_message(
                rate * self._robot.kinematics(self._q).jacobian[:, joint]))
            self.spin(1.0 / _RATE)

    def _stream(self, send: Callable[[Array], None]) -> None:
        """Send where the tip, or each joint, is along one motion to and fro."""
        begin = time.monotonic()
        while (elapsed := time.monotonic() - begin) < _LASTS:
            send(self._swung(_SWING * np.sin(np.pi * elapsed / _HALF)))
            self.spin(1.0 / _RATE)

    def _around(self) -> None:
        """Go from one side of an obstacle to the other and back."""
        sides = [HOME + by * np.eye(len(HOME))[0] for by in (_SIDE, -_SIDE)]
        self._reach('free ways', sides[0])
        ball = markers_of([Obstacle(
            'ball', self._robot.kinematics(HOME).tip_position, np.full(3, _BALL))],
            self._robot.base_frame)
        self._obstacles.publish(ball)
        self.spin(0.2)
        for q in (sides[1], sides[0]):
            there = self._robot.kinematics(q).tip_position
            self._send_pose(q)
            self._arrive('free ways', lambda there=there: float(np.linalg.norm(
                self._robot.kinematics(self._q).tip_position - there)))
        for marker in ball.markers:
            marker.action = marker.DELETE
        self._obstacles.publish(ball)
        self.spin(0.2)

    def close(self) -> None:
        """Leave."""
        self._executor.shutdown()
        self._node.destroy_node()

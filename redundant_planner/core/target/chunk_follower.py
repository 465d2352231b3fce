"""Follows chunks: where on one the arm is, how far behind its time, and when the next takes over.

Time passes along a chunk as it does by the clock, or more slowly where the limits ask for that, or
where the safety filter lets through less. What is lost is not made up for: the next chunk begins
at its own time.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import PathJoints
from redundant_planner.core.horizon.preview import PreviewAhead
from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.robot.turns import nearest_turn
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.joint_chunk_way import JointChunkWay
from redundant_planner.core.target.joint_motion import JointMotion
from redundant_planner.core.target.progress import Progress, REACHED, TargetState
from redundant_planner.core.target.smooth_curve import Motion
from redundant_planner.core.target.tip_chunk_way import TipChunkWay, Which

Array = npt.NDArray[np.float64]

# The arm begins its way anew from where it is if that is so far from where it should be [rad, m].
_STRAYED = 0.1
# Deadband of the feedback at the end [rad, m], and with so little left the way is over [s].
_AT_REST, _OVER = 1e-5, 1e-9
# Largest speed of the feedback to the way [rad/s, m/s]; in what time the tip's reference gets
# back to it [s].
_FEEDBACK_SPEED, _CLOSING_TIME = 0.2, 0.1
# How often the joints are looked at along a way of the tip [s].
_REFRESH = 0.1
# An arm is blocked for which time has passed at less than this share for so long, and until it has
# passed for as long again: chunks that follow each other fast end nothing [s].
_LEAST_SPEED, _PATIENCE = 0.02, 0.5


class ChunkFollower:
    """Takes one arm along one chunk after the other."""

    def __init__(
        self, robot: Robot, limits: Limits, joints: PathJoints, full_speed: Array, gain: float,
        which: Which,
    ) -> None:
        """Prepare for an arm.

        Args:
            robot: the arm.
            limits: of its joints.
            joints: how they are weighed and bounded.
            full_speed: highest linear and angular speed of the tip [m/s, rad/s].
            gain: of the feedback to a way of the joints [1/s].
            which: tip follows chunks of poses.
        """
        self._robot, self._limits, self._joints = robot, limits, joints
        self._full_speed, self._gain = full_speed, gain
        self._which, self._tip = which, which.tip
        self._controlled = robot.full_twist(np.ones(robot.m))[6 * self._tip:6 * self._tip + 6]
        self.reset()

    def reset(self) -> None:
        """Forget the chunk."""
        self._given: Chunk | None = None
        self._waiting = 0.0  # until the given chunk begins, while another one is followed [s]
        self._way: JointChunkWay | TipChunkWay | None = None
        self._followed: Chunk | None = None  # the one that the way leads along
        self._before: tuple[Array, Array] | None = None  # q̇ and the tip's twist, a tick ago
        self._s = self._clock = 0.0  # where on the chunk the arm is, and should be [s]
        self._share = self._wanted = 0.0  # of the pace: that was followed, and is asked for
        self._off = 0.0  # how far the arm was from where it should be [rad, m]
        self._age = 0.0  # of the look ahead [s]
        self._stuck = 0.0  # for how long time has stood, less by how long it has passed since [s]

    def go_on_from(self, other: ChunkFollower) -> None:
        """Take over the chunk of a follower with other limits, where that has got to."""
        self._given, self._followed = other._given, other._followed
        self._waiting, self._s, self._clock = other._waiting, other._s, other._clock

    @property
    def is_active(self) -> bool:
        """Whether a chunk commands."""
        return self._given is not None

    def joints(self, start: Start, chunk: Chunk, followed: Array, delay: float) -> (
            JointMotion | None):
        """Go on by a tick; return what the joints shall do, None along a chunk of poses.

        Args:
            start: of the tick.
            chunk: that is given; the same object as long as it holds.
            followed: (6,) the tip's twist in the last tick as far as followed, in command axes.
            delay: of the commands behind what is planned [s].
        """
        twist = self._in_base_axes(followed, start.reference_of(self._tip))
        now, before = (start.previous, twist), self._before
        self._before = now
        bends = [np.zeros(len(part)) if before is None else (part - earlier) / start.dt
                 for part, earlier in zip(now, before or now)]
        self._choose(start, chunk, delay, bends, twist)
        assert self._way is not None
        self._clock += start.dt * (self._s < self._way.end)
        self._wanted = self._way.pace.share_at(self._s, self._share, start.dt)
        if isinstance(self._way, TipChunkWay):
            return None
        here, there = self._way.at(np.array((self._s, self._s + self._wanted * start.dt)))
        off = here - start.arm.q
        self._off = float(np.abs(off).max())
        if self._is_over and self._off < _AT_REST:
            off = np.zeros_like(off)
        return JointMotion((there - here) / start.dt, np.clip(
            self._gain * off, -_FEEDBACK_SPEED, _FEEDBACK_SPEED))

    def twist(self, start: Start) -> tuple[Array, PreviewAhead | None]:
        """Return the twist (6,) for a tick in command axes, and those ahead; after `joints`."""
        way, reference = self._way, start.reference_of(self._tip)
        assert isinstance(way, TipChunkWay), 'the joints follow a chunk of their own'
        here, there = (Pose(*pose) for pose in zip(*way.along(
            np.array((self._s, self._s + self._wanted * start.dt)))))
        off = se3.pose_error(here, reference, False)
        self._off = float(np.abs(self._controlled * se3.pose_error(
            here, reference, self._robot.in_tool)).max())
        back = np.zeros(6)
        if self._off > _AT_REST:
            back = np.clip(off / _CLOSING_TIME, -_FEEDBACK_SPEED, _FEEDBACK_SPEED)
        twist = se3.pose_error(there, here, False) / start.dt + back
        # In command axes that turn with the tip: those of the middle of the tick.
        middle = se3.displaced(
            reference, np.concatenate((np.zeros(3), 0.5 * start.dt * twist[3:])), False)
        if self._robot.in_tool:
            twist = se3.turned(twist, middle.rotation.T)
        elapsed = way.pace.passed(way.times, self._s)
        return twist * self._controlled, None if self._is_over else way.preview.ahead(elapsed)

    def went_on(self, followed: float, residual: float, dt: float) -> None:
        """Note which share of the tick's motion was followed, and of the last one's remained."""
        assert self._way is not None
        self._share = min(max(followed * self._wanted + residual * self._share, 0.0), 1.0)
        self._s = min(self._s + self._share * dt, self._way.end)
        stands = self._share < _LEAST_SPEED and not self._is_over
        self._stuck = min(max(self._stuck + (dt if stands else -dt), 0.0), 2.0 * _PATIENCE)

    def missed(self, seconds: float) -> None:
        """Note that ticks did not take place, in which the arm went on at its pace."""
        if self._given is not self._followed:
            self._waiting -= seconds
        if self._way is not None:  # it has begun since parameters changed
            self._clock += seconds * (self._s < self._way.end)
            self.went_on(0.0, 1.0, seconds)

    def progress(self, chunk: Chunk, arm: Kinematics) -> Progress:
        """Return how far the arm has come, from where it is."""
        way, end = self._way, chunk.end
        assert way is not None and self._followed is not None
        tip = arm.tips.each[self._tip]
        joint = 0.0
        if isinstance(end, Pose):
            goal = end
        else:
            end = nearest_turn(np.clip(end, self._limits.positions[1], self._limits.positions[0]),
                               arm.q, self._robot.position_max)
            there = self._robot.kinematics(end)
            goal, joint = there.tips.each[self._tip], float(np.abs(end - arm.q).max())
        away = self._controlled * se3.pose_error(goal, tip, self._robot.in_tool)
        distance, angle = math.sqrt(away[:3] @ away[:3]), math.sqrt(away[3:] @ away[3:])
        there_now = max(distance, angle) if isinstance(end, Pose) else joint
        state = TargetState.MOVING
        if self._is_over and self._followed is chunk and there_now < REACHED:
            state = TargetState.REACHED
        elif self._stuck >= _PATIENCE:
            state = TargetState.BLOCKED
        off = (way.off(self._s, tip) if isinstance(way, TipChunkWay) else
               way.off(self._s, arm.q))
        return Progress(state, distance, angle, self._seconds, 0.0, joint,
                        max(self._clock - self._s, 0.0), off)

    @property
    def _is_over(self) -> bool:
        return self._way is None or self._way.end - self._s < _OVER

    @property
    def _seconds(self) -> float:
        """Time until the end if nothing gets in the way [s]."""
        assert self._way is not None
        way = self._way
        return float(way.times[-1]) - way.pace.passed(way.times, self._s) + max(
            way.end - way.pace.end, 0.0)

    def _choose(
        self, start: Start, chunk: Chunk, delay: float, bends: list[Array], twist: Array,
    ) -> None:
        """Begin the given chunk if it is time for that, or anew where the arm has strayed."""
        if chunk is not self._given:
            self._given, self._waiting = chunk, -(chunk.late + delay)
            if self._waiting <= 0.0 or self._is_over:
                self._begin(start, chunk, -self._waiting, bends, twist)
                self._clock = self._s
        elif self._way is None:
            self._begin(start, self._followed or chunk, self._s, bends, twist)
        elif self._followed is not chunk:
            self._waiting -= start.dt
            if self._waiting <= 0.0 or self._is_over:
                self._begin(start, chunk, -self._waiting, bends, twist)
                self._clock = self._s
        elif self._off > _STRAYED:
            self._begin(start, chunk, self._s, bends, twist)
        elif isinstance(self._way, TipChunkWay):
            self._age += start.dt
            if self._age >= _REFRESH and not self._is_over:
                self._age = 0.0
                self._way.look(self._s, start)

    def _begin(
        self, start: Start, chunk: Chunk, begin: float, bends: list[Array], twist: Array,
    ) -> None:
        """Begin a chunk at a time of it [s], from where the arm is and how it moves."""
        robot, limits = self._robot, self._limits
        bend = np.clip(bends[0], -limits.acceleration_max, limits.acceleration_max)
        if chunk.of_poses:
            self._way = TipChunkWay(
                robot, limits, self._joints, self._full_speed, chunk, begin, start,
                Motion(np.zeros(6), twist, bends[1]), self._which)
        else:
            self._way = JointChunkWay(
                robot, limits, self._full_speed, chunk, begin,
                Motion(start.arm.q, start.previous, bend))
        self._followed, self._s = chunk, self._way.begin
        self._share = self._way.share
        self._age = self._off = 0.0

    def _in_base_axes(self, twist: Array, tip: Pose) -> Array:
        return se3.turned(twist, tip.rotation) if self._robot.in_tool else twist

"""The way to a target: free, in a line, or first the one and then the other; or along a chunk.

To joint positions it is always free.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import Gains, RobotConstants
from redundant_planner.core.horizon.least_norm_path import path_joints
from redundant_planner.core.horizon.preview import PreviewAhead
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.redundancy.command import SLOWEST
from redundant_planner.core.redundancy.coupling import Coupling
from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, Poses, same_poses
from redundant_planner.core.robot.turns import nearest_turn
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.safety.own_barriers import OwnBarriers
from redundant_planner.core.safety.stages import Filtered
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.chunk_follower import ChunkFollower
from redundant_planner.core.target.free_space import FreeSpace
from redundant_planner.core.target.free_way import FreeWay, Stretch
from redundant_planner.core.target.goal import Goal, Target, TipGoals
from redundant_planner.core.target.joint_motion import JointMotion
from redundant_planner.core.target.joint_stream import JointStream
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.core.target.progress import Progress, REACHED, TargetState
from redundant_planner.core.target.straight_way import StraightWay
from redundant_planner.core.target.tip_chunk_way import Which

Array = npt.NDArray[np.float64]


class Aim(NamedTuple):
    """What a tick shall do about its target.

    Attributes:
        twist: (6,) of the tip, in command axes [m/s, rad/s].
        ahead: the twists to come, None where they are not known.
        joints: what the joints shall do, None where the tip's twist counts.
    """

    twist: Array
    ahead: PreviewAhead | None
    joints: JointMotion | None


class Way:
    """The way of one arm to its target."""

    def __init__(
        self, robot: Robot, parameters: PlannerParameters, limits: Limits,
        constants: RobotConstants, gains: Gains, *, before: Way | None, coupling: Coupling | None,
        own: OwnBarriers | None,
    ) -> None:
        """Prepare for an arm; the other arguments are made of the parameters.

        Args:
            robot, parameters, limits, constants, gains: of the arm.
            before: the way with other parameters; a chunk goes on where it has got to.
            coupling: of tips that hold something together.
            own: the user's barriers.
        """
        self._own = own
        self._robot, self._constants = robot, constants
        self._joints = path_joints(constants, gains, limits)
        full_speed = np.maximum(parameters.twist_speeds, SLOWEST)
        # Of the tip where the joints have a way of their own: only as far as the user limits it.
        joints_speed = np.maximum(
            (parameters.limits_linear_speed, parameters.limits_angular_speed), SLOWEST)
        self._coupling = coupling
        # Of coupled tips the first one leads.
        self._lines = tuple(
            StraightWay(robot, limits, self._joints, full_speed, parameters.target_lag, tip,
                        coupling)
            for tip in range(1 if coupling else len(robot.tips)))
        self._line = self._lines[0]
        self._stream = JointStream(limits, robot.position_max, parameters.target_lag)
        self._free = FreeWay(
            robot, limits, constants.scaling, joints_speed, parameters.feedback_gain,
            effort=parameters.target_effort, gives_way=parameters.target_gives_way)
        # Of all joints the first one.
        self._chunks = tuple(
            ChunkFollower(robot, limits, self._joints, full_speed, parameters.feedback_gain,
                          Which(tip, coupling)) for tip in range(len(self._lines)))
        self._straight = parameters.target_path == 'straight'
        self._range = limits.positions[1], limits.positions[0]
        self._space: tuple[InflatedObstacles, FreeSpace] | None = None
        self._given: Goal | Poses | None = None
        if before is not None:
            for chunks, chunks_before in zip(self._chunks, before._chunks):
                chunks.go_on_from(chunks_before)
            for line, known in zip(self._lines, before._lines):
                line.go_on_from(known)
            self._stream.go_on_from(before._stream)
            self._free.go_on_from(before._free)
            self._given = before._given

    def reset(self) -> None:
        """Forget the target."""
        self._given = None
        for line in self._lines:
            line.reset()
        self._stream.reset()
        self._free.reset()
        self._forget_chunks()

    def forget_past(self) -> None:
        """Forget the ways that the arm has gone, too."""
        self._free.forget_past()

    def _forget_chunks(self) -> None:
        for chunks in self._chunks:
            chunks.reset()

    def aim(
        self, start: Start, target: Target, followed: Array, delay: float,
        obstacles: Callable[[], InflatedObstacles], news: Sequence[Sighting] = (), *,
        free: bool = False,
    ) -> Aim:
        """Return what to do in a tick.

        Args:
            start: of the tick.
            target: where to; joints go no further than their limits allow.
            followed: (6,) the twist of the last tick as far as it was followed, in command axes.
            delay: of the commands behind what is planned [s].
            obstacles: returns those now, for links with their margin; the same object while
                nothing changes.
            news: the targets that came since the last tick; where there are none, one came if
                `target` is another than in the last tick.
            free: whether the way is free in any case.
        """
        if isinstance(target, Chunk):
            return self._along(start, target, followed, delay)
        if isinstance(target, TipGoals):
            return self._to_goals(start, target, followed, delay, obstacles, news, free=free)
        self._forget_chunks()
        line, stream, way = self._line, self._stream, self._free
        if not news and not _same(target, self._given):
            news = (Sighting(target),)
        self._given = target
        if isinstance(target, Pose):
            stream.reset()
            target = line.sense(target, news, start)
        else:
            for other in self._lines:
                other.reset()
            stream.sense(news, start)
            target = self._within_limits(target)
            if stream.moves:
                way.reset()
                return self._by(stream.motion(start, delay), start)
        joints: JointMotion | None = None
        if isinstance(target, Pose) and not free and (self._straight or line.follows_stream):
            way.reset()
        else:
            joints = way.motion(
                start, target, lambda: self._space_among(obstacles()), stuck=line.is_stuck)
        if joints is not None:
            line.begin()
            return self._by(joints, start)
        assert isinstance(target, Pose)  # a free way leads the joints to the end
        return Aim(*line.command(start, target, followed, delay), None)

    def _to_goals(
        self, start: Start, targets: TipGoals, followed: Array, delay: float,
        obstacles: Callable[[], InflatedObstacles], news: Sequence[Sighting], *, free: bool,
    ) -> Aim:
        """Return what to do about targets of several tips, see `aim`; `news` are tip → pose."""
        known, self._given = self._given, targets.poses
        poses = []
        for t, (line, pose) in enumerate(zip(self._lines, targets.poses.each)):
            tip = self._robot.tips[t]
            own = [Sighting(at, seen.age) for seen in news if isinstance(seen.target, Mapping)
                   for at in (seen.target.get(tip),) if isinstance(at, Pose)]
            if not news and not (isinstance(known, Poses)
                                 and np.array_equal(known.position[t], pose.position)
                                 and np.array_equal(known.rotation[t], pose.rotation)):
                own = [Sighting(pose)]
            poses.append(line.sense(pose, own, start))
        self._stream.reset()
        coupled = self._coupling is not None
        parts = start.command.reshape(-1, 6)
        by_twists = [not coupled and bool(part.any()) for part in parts]
        straight = (self._straight and not free) or any(by_twists) or any(targets.chunks) or any(
            line.follows_stream for line in self._lines)
        joints: JointMotion | None = None
        if straight or coupled:
            self._free.reset()
        else:
            joints = self._free.motion(
                start, Poses.of(*poses), lambda: self._space_among(obstacles()),
                stuck=any(line.is_stuck for line in self._lines))
        if joints is not None:
            self._forget_chunks()
            for line in self._lines:
                line.begin()
            return self._by(joints, start)
        twists = np.zeros(6 * len(self._robot.tips))
        for t, (line, pose, chunk, chunks) in enumerate(zip(
                self._lines, poses, targets.chunks, self._chunks)):
            own_part = slice(6 * t, 6 * t + 6)
            if chunk is None:
                chunks.reset()
            if by_twists[t]:
                line.begin()
                twists[own_part] = start.command[own_part]
            elif chunk is None:
                twists[own_part], _ = line.command(start, pose, followed[own_part], delay)
            else:
                line.reset()
                chunks.joints(start, chunk, followed[own_part], delay)
                twists[own_part], _ = chunks.twist(start)
        return Aim(twists, None, None)

    def _by(self, joints: JointMotion, start: Start) -> Aim:
        """Return what to do in a tick that the joints' motion is given for."""
        return Aim(self._robot.full_twist(start.arm.jacobian @ joints.velocity), None, joints)

    def _along(self, start: Start, chunk: Chunk, followed: Array, delay: float) -> Aim:
        """Return what to do in a tick along a chunk, see `aim`."""
        chunks = self._chunks[0]
        if not chunks.is_active:
            self.reset()
        joints = chunks.joints(start, chunk, followed[:6], delay)
        if joints is None:
            return Aim(*chunks.twist(start), None)
        return self._by(joints, start)

    def catch_up(self) -> bool:
        """Think about a free way, see `FreeWay.catch_up`."""
        return self._free.catch_up()

    @property
    def is_along_chunk(self) -> bool:
        """Whether a chunk is the target, or that of a tip."""
        return any(chunks.is_active for chunks in self._chunks)

    def went_on(self, result: Filtered, dt: float) -> None:
        """Note what a tick made of what the joints should do, or tips along chunks."""
        if not self.is_along_chunk:
            self._free.went_on(result.scale, result.residual, dt)
        for t, chunks in enumerate(self._chunks):
            if chunks.is_active:
                share = result.scale if result.scales is None else float(result.scales[t])
                chunks.went_on(share, result.residual, dt)

    def missed(self, seconds: float, *, by_joints: bool) -> None:
        """Note that ticks did not take place, in which the arm went on as in the last one.

        Args:
            seconds: how long they would have taken.
            by_joints: whether the joints followed a way of theirs.
        """
        for line in self._lines:
            line.wait(seconds)
        self._stream.wait(seconds)
        if by_joints and not self.is_along_chunk:
            self._free.went_on(0.0, 1.0, seconds)
        for chunks in self._chunks:
            if chunks.is_active:
                chunks.missed(seconds)

    def progress(self, target: Target, arm: Kinematics) -> Progress:
        """Return how far the arm has come, from where it is."""
        if isinstance(target, Chunk):
            return self._chunks[0].progress(target, arm)
        tip = arm.tips.first
        if isinstance(target, Pose):
            found = self._line.progress(target, tip)
        elif isinstance(target, TipGoals):
            found = _together([
                line.progress(pose, tip) if chunk is None else chunks.progress(chunk, arm)
                for line, pose, tip, chunk, chunks in zip(
                    self._lines, target.poses.each, arm.tips.each, target.chunks, self._chunks)])
            if any(target.chunks):
                return found
        else:
            target = nearest_turn(
                self._within_limits(target), arm.q, self._robot.position_max)
            there = self._robot.kinematics(target)
            off = float(np.abs(target - arm.q).max(initial=0.0))
            found = self._line.progress(
                there.tips.first, tip)._replace(
                    state=TargetState.REACHED if off < REACHED else TargetState.MOVING, joint=off)
        free = self._free
        if found.state is TargetState.REACHED:
            return found
        if self._stream.patience.is_over:
            return found._replace(state=TargetState.BLOCKED)
        if free.out_of_reach:
            if found.state is not TargetState.MOVING:
                return found._replace(state=TargetState.OUT_OF_REACH)
        elif free.in_vain or (free.stretch is Stretch.THINKING and free.tried_line):
            return found._replace(state=TargetState.BLOCKED)
        elif free.stretch is not Stretch.LINE:
            return found._replace(
                state=(TargetState.THINKING if free.stretch is Stretch.THINKING
                       else TargetState.MOVING), seconds=free.seconds)
        return found

    @property
    def lacks(self) -> str:
        """Why there is no way to the target; empty where there is one, or the arm still thinks."""
        return self._free.lacks

    def _within_limits(self, q: Array) -> Array:
        """Return joint positions (n,) no further than the limits and their margin allow."""
        return np.clip(q, *self._range)

    def _space_among(self, obstacles: InflatedObstacles) -> FreeSpace:
        """Return where the arm may be, the same object for obstacles that are the same."""
        known = self._space is not None and (
            self._space[0] is obstacles or all(map(np.array_equal, self._space[0], obstacles)))
        if self._space is None or not known:
            self._space = obstacles, FreeSpace(
                self._robot, self._constants, self._joints, obstacles, self._own)
        return self._space[1]


def _same(target: Goal, known: Goal | Poses | None) -> bool:
    """Return whether a target is the one that is known already."""
    if target is known:
        return True
    if known is None or type(target) is not type(known):
        return False
    if isinstance(target, tuple) and isinstance(known, tuple):
        return same_poses(target, known)
    return bool(np.array_equal(target, known))


def _together(found: Sequence[Progress]) -> Progress:
    """Return how far several tips have come: what the one that is worst off says."""
    states = [progress.state for progress in found]
    state = next((state for state in (
        TargetState.OUT_OF_REACH, TargetState.BLOCKED, TargetState.MOVING) if state in states),
        TargetState.REACHED)
    return Progress(state, *(max(getattr(progress, name) for progress in found)
                             for name in Progress._fields[1:]))

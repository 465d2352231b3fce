"""To a target along a straight line and about one axis.

Each tick aims from where the tip should be now at the target: position and orientation arrive
together. The twist changes no faster than the joints can follow, and a target that moves while the
arm is on its way is taken up from the present speed.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import least_norm_path, PathJoints
from redundant_planner.core.horizon.preview import Preview, PreviewAhead
from redundant_planner.core.redundancy.coupling import Coupling
from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, Poses
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.target.goal_postures import off_poses
from redundant_planner.core.target.moving_target import (
    MovingTarget,
    numbers_of,
    POSE_GATE,
    pose_of,
    Sighting,
    twist_of,
)
from redundant_planner.core.target.patience import Patience
from redundant_planner.core.target.profile import Profile, profile_of
from redundant_planner.core.target.progress import Progress, REACHED, TargetState

Array = npt.NDArray[np.float64]

# Nodes of the way at which the joints are looked at, and how often that is done again [s].
_NODES = 12
_REFRESH = 0.1
# The end of a way is not looked at again: the steps to its nodes would be mostly what the posture
# is beside the line [s at full speed].
_SHORT = 0.02
# Another target has the joints looked at again at once if it changes the way by more than this
# share of its length.
_NEWS = 0.1
# A posture settles at the target in so many times so many steps.
_SETTLING, _STEPS_AT_ONCE = 5, 4
# How near the way comes is looked at in every third node, and this is near enough [m, rad].
_LOOKED_AT = 3
_OUT_OF_REACH = 5e-3
# A target that moves is followed while it is no further ahead than this [s at full speed].
_CLOSE_BEHIND = 0.05
# A stream that goes on after a silence is taken up in a line if it is no further away [m, rad].
_NEAR, _NEAR_ANGLE = 0.3, 1.0
# In what time the tip makes good what it is behind a target that moves [s], braking at such a
# share of what the joints are able to.
_CLOSING_TIME, _BRAKING = 0.08, 0.5
# A way shorter than this is over [s at full speed].
_OVER = 1e-7
# With so little left an arm is not stuck [s at full speed].
_AT_END = 1e-3
# A squared length of 0 counts as this, for the sake of a division.
_TINY = 1e-12


class _Looked(NamedTuple):
    """What a look along the way has found.

    Attributes:
        profile: how fast the tip may be.
        target: that the way led to.
        preview: the twists, from full stop or the speed of then.
        times: (K + 1,) when the tip is at the profile's nodes [s].
        miss: how near the arm gets to the target [m, rad].
    """

    profile: Profile
    target: Pose
    preview: Preview
    times: Array
    miss: float


class StraightWay:
    """The way of one arm to its target.

    Attributes:
        left: what is left of the way [s at full speed].
    """

    def __init__(
        self, robot: Robot, limits: Limits, joints: PathJoints, full_speed: Array, lag: float,
        tip: int = 0, coupling: Coupling | None = None,
    ) -> None:
        """Prepare for a tip of an arm.

        Args:
            robot: the arm.
            limits: of its joints.
            joints: how they are weighed and bounded.
            full_speed: highest linear and angular speed of the tip [m/s, rad/s].
            lag: behind a stream of poses [s].
            tip: which.
            coupling: that moves the others with it; None where they stay.
        """
        self._robot, self._limits, self._joints = robot, limits, joints
        self._full = np.repeat(full_speed, 3)
        self._controlled = robot.full_twist(np.ones(robot.m))[6 * tip:6 * tip + 6]
        self._tip, self._coupling = tip, coupling
        self._target = MovingTarget(lag, POSE_GATE)
        self.reset()

    def reset(self) -> None:
        """Forget the target."""
        self._target.reset()
        self._given: Array | None = None  # the latest pose's numbers
        self.begin()

    def go_on_from(self, other: StraightWay) -> None:
        """Take over what another one knows of the target."""
        self._target.go_on_from(other._target)
        self._given = other._given

    def begin(self) -> None:
        """Forget the way, but not how the target moves."""
        self.left = self._seconds = 0.0
        self._looked: _Looked | None = None
        self._age = 0.0
        self._patience = Patience()

    @property
    def follows_stream(self) -> bool:
        """Whether the target is a stream of poses, or was one until it fell silent."""
        return self._target.moves

    @property
    def is_stuck(self) -> bool:
        """Whether the way has not become shorter for a while, before its end."""
        return self._patience.is_over and self.left > _AT_END

    def wait(self, seconds: float) -> None:
        """Let time go by: a stream has gone on meanwhile."""
        self._target.wait(seconds)

    def sense(
        self, given: Pose, news: Sequence[Sighting], start: Start,
    ) -> Pose:
        """Return where the target is now.

        Args:
            given: the latest one.
            news: those that came since the last tick.
            start: of the tick.
        """
        numbers: list[tuple[Array, float | None]] = []
        for target, age in news:
            assert isinstance(target, Pose)
            self._given = numbers_of(target, self._given)
            numbers.append((self._given, age))
        reference = start.reference_of(self._tip)
        self._target.sense(numbers, start.dt, lambda n: self._is_near(pose_of(n), reference))
        estimate = self._target.estimate
        return given if estimate is None else pose_of(estimate.value)

    def command(
        self, start: Start, target: Pose, followed: Array, delay: float,
    ) -> tuple[Array, PreviewAhead | None]:
        """Return the twist (6,) for this tick in command axes, and those ahead.

        Args:
            start: of the tick.
            target: in the base frame, from `sense`.
            followed: (6,) the twist of the last tick as far as it was followed, in command axes.
            delay: of the commands behind what is planned [s].
        """
        estimate, rates = self._target.estimate, np.zeros(6)
        reference = start.reference_of(self._tip)
        if estimate is not None:
            target = pose_of(estimate.after(delay).value)
            value, velocity = estimate.after(delay + 0.5 * start.dt)[:2]
            rates = twist_of(value, velocity)
        # Base axes: a line is straight there.
        away = self._part(se3.pose_error(target, reference, False), reference)
        velocity = self._part(rates, reference)
        self.left = self._length(away)
        self._patience.note(self.left, start.dt)
        if self._is_close_behind:
            self._patience = Patience()
        if self.left < _OVER and not rates.any():
            self._looked, self._seconds = None, 0.0
            return np.zeros(6), None
        self._age += start.dt
        now = self._in_base_axes(followed, reference)
        looked = self._looked = (
            None if self._is_close_behind else self._look(start, target, away, now))
        closing = self._closing(start, away, looked)
        twist = self._limited(velocity + closing * away, now, start)
        # In command axes that turn with the tip: those of the middle of the tick.
        middle = se3.displaced(
            reference, np.concatenate((np.zeros(3), 0.5 * start.dt * twist[3:])), False)
        twist = self._in_command_axes(twist, middle)
        if looked is None or self._target.moves:
            return twist, None
        profile = looked.profile
        elapsed = float(np.interp(-self.left, -profile.left, looked.times))
        self._seconds = float(looked.times[-1]) - elapsed
        return twist, looked.preview.ahead(elapsed)

    def progress(self, target: Pose, tip: Pose) -> Progress:
        """Return how far the tip has come."""
        away = self._in_command_axes(se3.pose_error(target, tip, False), tip) * self._controlled
        distance, angle = math.sqrt(away[:3] @ away[:3]), math.sqrt(away[3:] @ away[3:])
        miss = 0.0 if self._looked is None else self._looked.miss
        miss = miss if miss > _OUT_OF_REACH else 0.0
        state = TargetState.MOVING
        if max(distance, angle) < REACHED:
            state = TargetState.REACHED
        elif self._patience.is_over:
            state = TargetState.OUT_OF_REACH if miss else TargetState.BLOCKED
        return Progress(state, distance, angle, self._seconds, miss)

    def _is_near(self, target: Pose, tip: Pose) -> bool:
        """Return whether a stream that goes on there is taken up."""
        away = self._part(se3.pose_error(target, tip, False), tip)
        return bool(np.linalg.norm(away[:3]) < _NEAR and np.linalg.norm(away[3:]) < _NEAR_ANGLE)

    def _part(self, displacement: Array, tip: Pose) -> Array:
        """Return the part (6,) of a displacement or twist that is controlled, in base axes."""
        if self._controlled.all():
            return displacement
        return self._in_base_axes(
            self._in_command_axes(displacement, tip) * self._controlled, tip)

    def _length(self, away: Array) -> float:
        """Return how long a displacement (6,) takes at full speed [s]."""
        share = away / self._full
        return max(math.sqrt(share[:3] @ share[:3]), math.sqrt(share[3:] @ share[3:]))

    @property
    def _is_close_behind(self) -> bool:
        """Whether the target is a stream that the tip follows."""
        return self._target.moves and self.left < _CLOSE_BEHIND

    def _closing(self, start: Start, away: Array, looked: _Looked | None) -> float:
        """Return which share of the way to make good [1/s].

        Args:
            start: of the tick.
            away: (6,) the way, in base axes.
            looked: what is known of it; None for a stream that is close ahead.
        """
        if looked is None:
            braking = _BRAKING * self._ability(start, away)
            return min(math.sqrt(2.0 * braking), 1.0 / _CLOSING_TIME)
        profile = looked.profile
        f = profile.speed_at(min(self.left, profile.left[0]), start.dt)
        closing = f / max(self.left, _OVER)
        return min(closing, 1.0 / _CLOSING_TIME) if self._target.moves else closing

    def _limited(self, twist: Array, before: Array, start: Start) -> Array:
        """Return the twist that is nearest to the wanted one and no leap from the one before."""
        leap = twist - before
        return before + min(self._ability(start, leap) * start.dt, 1.0) * leap

    def _ability(self, start: Start, change: Array) -> float:
        """Return how much of a change of the twist the joints are able to make [1/s].

        Args:
            start: of the tick.
            change: (6,) in base axes.
        """
        if not change.any():
            return math.inf
        tips = start.arm.tips
        here = Pose(tips.position[self._tip], tips.rotation[self._tip])
        there = se3.displaced(here, start.dt * change, False)
        # From here to here is what the tips are beside their references: none of the change.
        due = [self._all_tips(start, pose) for pose in (here, there)]
        nodes = least_norm_path(self._robot, start.arm.q, Poses(*map(np.concatenate, zip(*due))),
                                self._joints)
        rates = np.abs(nodes[1] - nodes[0]) / start.dt
        return 1.0 / max(float((rates / self._limits.acceleration_max).max()), _TINY)

    def _look(self, start: Start, target: Pose, away: Array, now: Array) -> _Looked:
        """Look along the way, if that is due."""
        looked = self._looked
        if looked is not None and (self._age < _REFRESH or self.left < _SHORT):
            moved = self._length(se3.pose_error(target, looked.target, False))
            if self._target.moves or moved <= _NEWS * self.left:
                return looked
        self._age = 0.0
        robot, reference = self._robot, start.reference_of(self._tip)
        # From where the tip should be: what it is beside that is none of the way.
        shares = np.linspace(0.0, 1.0, _NODES + 1)
        ways = [se3.displaced(reference, share * away, False) for share in shares]
        due = [self._all_tips(start, way) for way in ways]
        nodes = least_norm_path(robot, start.arm.q, Poses(*map(np.concatenate, zip(*due))),
                                self._joints)
        profile = profile_of(
            nodes, max(self.left, _OVER), self._limits.velocity_max,
            self._limits.acceleration_max)
        along = float(now @ away) / max(float(away @ away), _TINY) * self.left
        times, f = profile.times(min(max(along, 0.0), 1.0))
        twists = np.array([self._in_command_axes(speed / max(self.left, _OVER) * away, pose)
                           for speed, pose in zip(f, ways)])
        self._looked = _Looked(profile, target, Preview(times, twists), times,
                               self._miss(nodes, due[-1]))
        return self._looked

    def _all_tips(self, start: Start, pose: Pose) -> Poses:
        """Return where all tips are to be while this one is at a pose."""
        if self._coupling is not None:
            return self._coupling.tips(pose)
        poses = Poses(start.reference.position.copy(), start.reference.rotation.copy())
        poses.position[self._tip], poses.rotation[self._tip] = pose
        return poses

    def _miss(self, nodes: Array, target: Poses) -> float:
        """Return how near a way (K, n), or what settles from its end, comes to a target."""
        due = Poses(*(np.concatenate([part] * _STEPS_AT_ONCE) for part in target))
        nearest, q = off_poses(self._robot, nodes[-1], target), nodes[-1]
        if nearest < _OUT_OF_REACH:
            return nearest
        nearest = min(off_poses(self._robot, node, target) for node in nodes[::-_LOOKED_AT])
        for _ in range(_SETTLING):
            q = least_norm_path(self._robot, q, due, self._joints)[-1]
            nearest = min(nearest, off_poses(self._robot, q, target))
            if nearest < _OUT_OF_REACH:
                break
        return nearest

    def _in_command_axes(self, twist: Array, tip: Pose) -> Array:
        """Return a twist (6,) in base axes in those of commands."""
        return se3.turned(twist, tip.rotation.T) if self._robot.in_tool else twist

    def _in_base_axes(self, twist: Array, tip: Pose) -> Array:
        """Return a twist (6,) in axes of commands in the base's."""
        return se3.turned(twist, tip.rotation) if self._robot.in_tool else twist

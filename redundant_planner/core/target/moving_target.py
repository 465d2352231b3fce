"""A target that is sent again and again: where it is in each tick, and how fast it moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, shown, StateError
from redundant_planner.core.obstacles.scene import rotations
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.quaternions import quaternion_of
from redundant_planner.core.robot.se3 import checked_pose, Pose
from redundant_planner.core.target.goal import checked_goal, Goal, Target, TipGoals, TipTargets
from redundant_planner.core.target.smoother import Estimate, Sample, Smoother

Array = npt.NDArray[np.float64]

# Targets further apart in time are single ones [s], and so are two that are further apart than so
# many gates. Of a slow stream some may be missing: it has ended after this many of its gaps.
_LONGEST_GAP, _LEAP, _MISSED = 0.5, 2.0, 2.5
# One that is silent for longer than a clutch is pressed is a single target, where it ended [s].
_CLUTCH = 3.0
# A stamp is of a clock that was set if it is older than those before by more [s]. Two clocks run
# apart by less than this [s/s].
_SET, _DRIFT = 1.0, 1e-3
# A sender whose stamps are all the same has none [s].
_SAME = 1e-6
# How far a pose may always be from where it is expected: position [m], quaternion.
POSE_GATE = np.array((0.05, 0.05, 0.05, 0.075, 0.075, 0.075, 0.075))


class Sighting(NamedTuple):
    """A target that came since the last tick.

    Attributes:
        target: a pose, or joint positions (n,); of an arm with several tips, tip → pose.
        age: of its stamp [s], by whichever clocks: differences count. None without a stamp.
    """

    target: Goal | TipTargets
    age: float | None = None


def checked_news(
    news: Sequence[Sighting], target: Target | TipTargets | None, robot: Robot,
) -> tuple[Sighting, ...]:
    """Return the targets that came since the last tick, as arrays of numbers.

    Raises:
        StateError: one is no target, or of another kind than the one that holds, or an age is
            not finite.
    """
    found = []
    for given, age in news:
        checked: Goal | TipTargets
        if isinstance(given, Mapping):
            unknown = [tip for tip in given if tip not in robot.tips]
            if unknown:
                raise StateError(f'news has targets for {known(unknown)}; the tips of '
                                 f"'{robot.name}' are {known(robot.tips)}")
            checked = {tip: checked_pose(pose) for tip, pose in given.items()
                       if isinstance(pose, Pose)}
        else:
            checked = checked_goal(given, robot)
        if _kind_of(checked) is not _kind_of(target):
            raise StateError('news has a target of another kind than the one that holds: '
                             f'{shown(given)}')
        if age is not None and not abs(age) < math.inf:
            raise StateError(f'news has a target of age {age}; it must be finite, or None')
        found.append(Sighting(checked, age))
    return tuple(found)


def _kind_of(target: Target | TipTargets | None) -> type:
    """Return the type of a target, the same for all of several tips."""
    return TipGoals if isinstance(target, Mapping) else type(target)


class MovingTarget:
    """What is known of a target, as numbers (k,), that is given tick by tick.

    Attributes:
        moves: whether it is a stream, or was one until it fell silent some seconds ago.
        estimate: of a stream, now.
    """

    def __init__(self, lag: float, gate: Array) -> None:
        """Begin without a target.

        Args:
            lag: behind a stream [s].
            gate: (k,) how far a sample may always be from what is expected.
        """
        self._lag, self._gate = lag, gate
        self.reset()

    def reset(self) -> None:
        """Forget the target."""
        self.moves = False
        self.estimate: Estimate | None = None
        self._now = 0.0
        self._heard = -math.inf  # when the last one came [s]
        self._least_age = math.inf
        self._stamp = math.nan  # of the last one, by our clock [s]
        self._smoother: Smoother | None = None
        self._first: Sample | None = None  # of what may become a stream

    def go_on_from(self, other: MovingTarget) -> None:
        """Take over what another one knows, whose lag may have been another."""
        self.moves, self.estimate = other.moves, other.estimate
        self._now, self._heard = other._now, other._heard
        self._least_age, self._stamp = other._least_age, other._stamp
        self._smoother, self._first = other._smoother, other._first
        if self._smoother is not None:
            self._smoother.lag = self._lag

    def wait(self, seconds: float) -> None:
        """Let time go by."""
        self._now += seconds
        self._least_age += _DRIFT * seconds

    def sense(
        self, news: list[tuple[Array, float | None]], dt: float,
        resumes: Callable[[Array], bool],
    ) -> None:
        """Take what has come since the last tick.

        Args:
            news: numbers (k,) and ages, see `Sighting`, the latest last.
            dt: time since the last call [s].
            resumes: whether a stream goes on with these numbers after a silence.
        """
        self.wait(dt)
        for numbers, age in news:
            self._take(Sample(self._time_of(age), numbers), resumes)
        if self._now - self._heard > _CLUTCH:
            self.moves, self._smoother = False, None
        self.estimate = None if self._smoother is None else self._smoother.at(self._now)

    def _take(self, sample: Sample, resumes: Callable[[Array], bool]) -> None:
        gap = 0.0 if self._smoother is None else self._smoother.gap
        silent = self._now - self._heard > max(_LONGEST_GAP, _MISSED * gap)
        self._heard = self._now
        first, self._first = self._first, None
        if self._smoother is not None and not silent:
            self._smoother.take(sample, self._now)
        elif self.moves and resumes(sample.value):
            self._begin(sample)
        elif first is not None and not silent and self._goes_on(first, sample):
            self._begin(first).take(sample, self._now)
        else:
            self.moves, self._smoother, self._first = False, None, sample

    def _goes_on(self, first: Sample, second: Sample) -> bool:
        """Return whether two targets begin a stream: different ones, but near each other."""
        step = np.abs(second.value - first.value)
        return bool(step.any() and (step <= _LEAP * self._gate).all())

    def _begin(self, first: Sample) -> Smoother:
        """Begin a stream."""
        self.moves = True
        self._smoother = Smoother(self._lag, self._gate, first, self._now)
        return self._smoother

    def _time_of(self, age: float | None) -> float:
        """Return when a target was sent, by its stamp as far as that is good [s]."""
        before, self._stamp = self._stamp, self._now - (math.nan if age is None else age)
        if age is None or abs(self._stamp - before) < _SAME:
            return self._now
        if not abs(age - self._least_age) < _SET:
            self._least_age = age
        self._least_age = min(self._least_age, age)
        return self._now - (age - self._least_age)


def numbers_of(pose: Pose, near: Array | None) -> Array:
    """Return position and quaternion (7,), of the two quaternions the one nearer to another."""
    quaternion = quaternion_of(pose.rotation)
    if near is not None and quaternion @ near[3:] < 0.0:
        quaternion = -quaternion
    return np.concatenate((pose.position, quaternion))


def pose_of(numbers: Array) -> Pose:
    """Return the pose of a position and a quaternion (7,) of any length."""
    return Pose(numbers[:3].copy(), rotations(numbers[None, 3:])[0])


def twist_of(numbers: Array, rates: Array) -> Array:
    """Return the twist (6,) in base axes of a pose's numbers (7,) that change at rates (7,)."""
    (x, y, z, w), (a, b, c, d) = numbers[3:], rates[3:]
    # ω = 2 q̇ q⁻¹
    twice = 2.0 / float(numbers[3:] @ numbers[3:])
    return np.array((
        *rates[:3], twice * (w * a - x * d + y * c - z * b),
        twice * (w * b - y * d + z * a - x * c), twice * (w * c - z * d + x * b - y * a)))

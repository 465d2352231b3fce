"""A smooth way of the joints, and how fast the arm may be where on it."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.model import Robot
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.target.joint_curve import JointCurve
from redundant_planner.core.target.pace_along import pace_along

Array = npt.NDArray[np.float64]

# Pieces of the way at which the joints are looked at: of each span, at least, and at most.
_PIECES_PER_SPAN, _FEWEST_PIECES, _MOST_PIECES = 4, 24, 240
# Share of the acceleration limits that the way may take: what it was sampled at is not exact, and
# the feedback wants some.
_SHARE = 0.95
# No piece of the way is taken to be shorter than this share of the mean one.
_SHORTEST_PIECE = 0.1
# The square of the speed may exceed what is allowed by this share before it is too much.
_TOO_FAST = 0.02
# Postures of each span by which a way that is gone is remembered: motions from one to the next
# stay near it.
_GONE_PER_SPAN = 2
# A way shorter than this is over [s at its pace], and no piece is shorter.
_OVER = 1e-9


class JointWay:
    """One way, and how much of it is left.

    Its pace: a piece of the curve in the time that the fastest of all pieces may take.

    Attributes:
        left: what is left [s at its pace].
        share: of its pace at which the arm moved last.
        too_fast: whether the arm was faster at its beginning than it may be there.
    """

    def __init__(
        self, robot: Robot, limits: Limits, full_speed: Array, curve: JointCurve,
        velocity: Array, begin: float = 0.0,
    ) -> None:
        """Measure a curve.

        Args:
            robot: the arm.
            limits: of its joints.
            full_speed: highest linear and angular speed of the tip [m/s, rad/s].
            curve: the way.
            velocity: (n,) of the arm.
            begin: parameter of the curve where the arm is.
        """
        self._curve = curve
        pieces = min(max(_PIECES_PER_SPAN * curve.spans, _FEWEST_PIECES), _MOST_PIECES)
        nodes = curve.at(np.linspace(0.0, curve.spans, pieces + 1))
        times = _least_times(robot, limits, full_speed, nodes)
        step = max(float(times.min()), _SHORTEST_PIECE * float(times.mean()), _OVER)
        shares = step / np.maximum(times, step)
        self._pace = pace_along(
            nodes, 0.0, step, np.minimum(np.append(shares, 1.0), np.insert(shares, 0, 1.0)),
            limits.velocity_max, _SHARE * limits.acceleration_max)
        self._spans_per_second = curve.spans / self._pace.end
        now = begin / self._spans_per_second
        self.left = self._pace.end - now if times.any() else 0.0
        rate = np.array([np.interp(now / step, np.arange(pieces + 1), column)
                         for column in self._pace.rates.T])
        squared = float(rate @ rate)
        share = max(float(velocity @ rate) / squared, 0.0) if squared else 0.0
        most = float(np.interp(now / step, np.arange(pieces + 1), self._pace.squared))
        self.too_fast = share * share > (1.0 + _TOO_FAST) * most
        self.share = min(share, 1.0)
        self._wanted = 0.0
        self._times = self._pace.times(self.share if begin == 0.0 else 1.0)

    @property
    def over(self) -> bool:
        """Whether nothing is left."""
        return self.left <= _OVER

    @property
    def posture(self) -> Array:
        """Where the arm should be now (n,)."""
        return self._at(self.left)[0]

    @property
    def seconds(self) -> float:
        """Time until its end if nothing gets in the way [s]."""
        return float(self._times[-1]) - self._pace.passed(self._times, self._pace.end - self.left)

    @property
    def parameter(self) -> float:
        """Where on the curve the arm should be."""
        return (self._pace.end - self.left) * self._spans_per_second

    def parameter_in(self, seconds: float) -> float:
        """Return where on the curve the arm is after that time if nothing gets in the way."""
        at = np.arange(len(self._times)) * self._pace.step
        then = float(np.interp(self._pace.end - self.left, at, self._times)) + seconds
        return float(np.interp(then, self._times, at)) * self._spans_per_second

    @property
    def gone(self) -> Array:
        """Postures (k, n) on what is behind, from the first to the last."""
        count = max(math.ceil(_GONE_PER_SPAN * self.parameter), 1)
        return self._curve.at(np.linspace(0.0, self.parameter, count + 1))

    def ahead(self, count: int) -> Array:
        """Return postures (count, n) on what is left, the end among them."""
        left = np.linspace(self.left, 0.0, count + 1)[1:]
        return self._curve.at((self._pace.end - left) * self._spans_per_second)

    def velocity(self, dt: float) -> tuple[Array, Array]:
        """Return where the arm should be, and the velocity (n,) for the next tick, (n,) each."""
        if self.over:
            here, = self._at(0.0)
            self._wanted = 0.0
            return here, np.zeros_like(here)
        self._wanted = self._pace.share_at(self._pace.end - self.left, self.share, dt)
        here, there = self._at(self.left, self.left - self._wanted * dt)
        return here, (there - here) / dt

    def went_on(self, followed: float, residual: float, dt: float) -> None:
        """Note which share of the tick's motion was followed, and of the last one's remained."""
        self.share = min(max(followed * self._wanted + residual * self.share, 0.0), 1.0)
        self.left = max(self.left - self.share * dt, 0.0)

    def _at(self, *left: float) -> Array:
        """Return the postures (k, n) with so much left."""
        return self._curve.at((self._pace.end - np.array(left)) * self._spans_per_second)


def _least_times(robot: Robot, limits: Limits, full_speed: Array, nodes: Array) -> Array:
    """Return how long (N,) each piece between nodes (N + 1, n) takes at least [s]."""
    steps = np.diff(nodes, axis=0)
    times = np.abs(steps / limits.velocity_max).max(axis=1)
    if not np.isfinite(full_speed).any():
        return np.asarray(times)
    tips = robot.kinematics_along(nodes).tip_jacobian[:-1]
    twists = np.einsum('kij,kj->ki', tips, steps)
    return np.maximum.reduce((times, np.linalg.norm(twists[:, :3], axis=1) / full_speed[0],
                              np.linalg.norm(twists[:, 3:], axis=1) / full_speed[1]))

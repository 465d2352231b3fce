"""A smooth way of the joints, and how fast the arm may be where on it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.model import Robot
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.target.joint_curve import JointCurve
from redundant_planner.core.target.profile import profile_of

Array = npt.NDArray[np.float64]

# Pieces of the way at which the joints are looked at: of each span, at least, and at most.
_PIECES_PER_SPAN, _FEWEST_PIECES, _MOST_PIECES = 4, 12, 48
# A way shorter than this is over [s at full speed].
_OVER = 1e-9


class JointWay:
    """One way, and how much of it is left.

    Attributes:
        left: what is left [s at full speed].
        share: of full speed at which the arm moved last.
    """

    def __init__(
        self, robot: Robot, limits: Limits, full_speed: Array, curve: JointCurve,
        velocity: Array,
    ) -> None:
        """Measure a curve.

        Args:
            robot: the arm.
            limits: of its joints.
            full_speed: highest linear and angular speed of the tip [m/s, rad/s].
            curve: the way.
            velocity: (n,) at its start.
        """
        self._curve = curve
        pieces = min(max(_PIECES_PER_SPAN * curve.spans, _FEWEST_PIECES), _MOST_PIECES)
        u = np.linspace(0.0, curve.spans, pieces + 1)
        postures = curve.at(u)
        steps = np.diff(postures, axis=0)
        tips = robot.kinematics_along(postures).tip_jacobian[:-1]
        twists = np.einsum('kij,kj->ki', tips, steps)
        spans = np.maximum.reduce((
            np.abs(steps / limits.velocity_max).max(axis=1),
            np.linalg.norm(twists[:, :3], axis=1) / full_speed[0],
            np.linalg.norm(twists[:, 3:], axis=1) / full_speed[1]))
        along = np.concatenate((np.zeros(1), np.cumsum(spans)))
        self._length = self.left = max(float(along[-1]), _OVER)
        self._u, self._along = u, along
        nodes = curve.at(np.interp(np.linspace(0.0, along[-1], pieces + 1), along, u))
        self._profile = profile_of(
            nodes, self._length, limits.velocity_max, limits.acceleration_max)
        rate = (nodes[1] - nodes[0]) * (pieces / self._length)
        squared = float(rate @ rate)
        self.share = min(max(float(velocity @ rate) / squared, 0.0), 1.0) if squared else 0.0
        self._times = self._profile.times(self.share)[0]
        self._wanted = 0.0

    @property
    def over(self) -> bool:
        """Whether nothing is left."""
        return self.left <= _OVER

    @property
    def posture(self) -> Array:
        """Where the arm should be now (n,)."""
        return self._at(self.left)

    @property
    def seconds(self) -> float:
        """Time until its end if nothing gets in the way [s]."""
        return float(self._times[-1] - np.interp(-self.left, -self._profile.left, self._times))

    def ahead(self, count: int) -> Array:
        """Return postures (count, n) on what is left, the end among them."""
        left = np.linspace(self.left, 0.0, count + 1)[1:]
        return self._curve.at(np.interp(self._length - left, self._along, self._u))

    def velocity(self, dt: float) -> tuple[Array, Array]:
        """Return where the arm should be, and the velocity (n,) for the next tick, (n,) each."""
        if self.over:
            here = self._at(0.0)
            self._wanted = 0.0
            return here, np.zeros_like(here)
        share = self._profile.speed_at(self.left, dt)
        self._wanted = min(share, self.share + self._profile.speeding_at(self.left) * dt)
        here, there = self._at(self.left), self._at(self.left - self._wanted * dt)
        return here, (there - here) / dt

    def went_on(self, followed: float, residual: float, dt: float) -> None:
        """Note which share of the tick's motion was followed, and of the last one's remained."""
        self.share = min(max(followed * self._wanted + residual * self.share, 0.0), 1.0)
        self.left = max(self.left - self.share * dt, 0.0)

    def _at(self, left: float) -> Array:
        u = np.interp(self._length - left, self._along, self._u)
        return self._curve.at(np.array([u]))[0]

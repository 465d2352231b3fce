"""A target that is sent again and again: where it is between two messages, and how fast it moves.

A fading-memory filter (Brookner 1998): each new pose corrects the pose and the velocity that were
predicted for its moment. Between messages the target moves on, so the arm does not stop at each.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

# Targets further apart in time are single ones [s].
_LONGEST_GAP = 0.15
# A target that is this far from where it was predicted is another one [m, rad].
_LEAP = 0.1
# Time in which the filter forgets [s]: short for fast targets, long for jitter.
_MEMORY = 0.06
# How fast the mean gap between two messages follows the last ones.
_GAP_SHARE = 0.2
# After this many mean gaps without a message, and this long, the last one is where the target is.
_SILENCE, _LEAST_SILENCE = 3.0, 0.05


class MovingTarget:
    """What is known of a target that is given tick by tick.

    Attributes:
        moving: whether it is a stream of poses.
        velocity: (6,) of the target, in base axes [m/s, rad/s].
    """

    def __init__(self) -> None:
        """Begin without a target."""
        self.reset()

    def reset(self) -> None:
        """Forget the target."""
        self.moving = False
        self.velocity: Array = np.zeros(6)
        self._given: Pose | None = None
        self._pose: Pose | None = None
        self._since = math.inf  # the last message [s]
        self._gap = 0.0

    def at(self, given: Pose, dt: float) -> Pose:
        """Return where the target is now.

        Args:
            given: the latest message's. Two equal ones in a row count as one: the target stands.
            dt: time since the last call [s].
        """
        self._since += dt
        if self.moving and self._since > max(_SILENCE * self._gap, _LEAST_SILENCE):
            self._stand(given)
        elif self._pose is not None and self.moving:
            self._pose = se3.integrate(self._pose, self.velocity, dt, False)
        if self._given is None or not _same(given, self._given):
            self._take(given)
        return self._pose or given

    def _take(self, given: Pose) -> None:
        """Correct what was predicted by a new message."""
        gap, before, self._given, self._since = self._since, self._given, given, 0.0
        if gap > _LONGEST_GAP or before is None:
            self._stand(given)
            return
        if not self.moving:
            step = se3.pose_error(given, before, False)
            if np.abs(step).max() > _LEAP:
                self._stand(given)
                return
            self.moving, self._pose, self._gap = True, given, gap
            self.velocity = np.zeros(6)
            return
        assert self._pose is not None
        self._gap += _GAP_SHARE * (gap - self._gap)
        wrong = se3.pose_error(given, self._pose, False)
        if np.abs(wrong).max() > _LEAP:
            self._stand(given)
            return
        # Critically damped: the weight of earlier messages fades.
        fading = math.exp(-gap / _MEMORY)
        self._pose = se3.displaced(self._pose, (1.0 - fading**2) * wrong, False)
        self.velocity = self.velocity + (1.0 - fading) ** 2 / gap * wrong

    def _stand(self, given: Pose) -> None:
        """Take a target for one that stands where it was given."""
        self.moving, self._pose = False, given
        self.velocity = np.zeros(6)


def _same(a: Pose, b: Pose) -> bool:
    return a is b or bool(
        (a.position == b.position).all() and (a.rotation == b.rotation).all())

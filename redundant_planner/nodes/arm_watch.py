"""Whether the arm does what it is told, and whether something else moves it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from redundant_planner.core.safety.following import Following
from redundant_planner.nodes.standing_arm import StandingArm
from redundant_planner.nodes.supervisor import FRESH_AFTER, MOVED_BY_OTHERS, Supervisor

Array = npt.NDArray[np.float64]

# After so long without commands a late arm stands still, too [s].
_SETTLES = 0.5
# A standing arm that is measured this far from where it stood was moved: less is noise [rad, m].
_MOVED = 2e-3
# After longer without a look the process was stopped: a velocity went on meanwhile [s].
_SLEPT = 0.05


class ArmWatch:
    """Compares what was commanded with what was measured, and tells the supervisor.

    Attributes:
        anchor: (n,) where an arm stands that does not follow [rad, m]; None if it moves.
    """

    def __init__(
        self, supervisor: Supervisor, joint_names: Sequence[str], period: float,
        unheard: Callable[[], str],
    ) -> None:
        """Begin with an arm at rest.

        Args:
            supervisor: knows the measurements.
            joint_names: of the n joints.
            period: of the commands [s].
            unheard: returns a sentence about outputs that nobody hears; empty if there are none.
        """
        self.anchor: Array | None = None
        self._supervisor, self._unheard = supervisor, unheard
        self._following = Following(joint_names, period, 0.0)
        self._standing = StandingArm(period)
        self._looked_at = np.inf  # when it looked last [s]
        self._wished_at = -np.inf  # when somebody commanded the arm last [s]
        self._silent_since = np.inf  # since when nobody has been told anything [s]
        self._stood_at: Array | None = None  # where the arm came to stand then

    def begin(self, posture: Array, lag: float, dead_time: float) -> None:
        """Begin anew with an arm that is about to move.

        Args:
            posture: (n,) where it is [rad, m].
            lag, dead_time: of its drives, as far as they are known [s].
        """
        self._following.begin(posture, lag, dead_time)
        self._standing.begin(lag, dead_time)

    @property
    def travel(self) -> Array:
        """By how much each joint may be behind that is late (n,) [rad, m]."""
        return self._following.travel

    @property
    def sets_off(self) -> bool:
        """Whether the arm is not yet seen to move, where anybody cares whether it follows."""
        return self._following.tolerance > 0.0 and self._following.sets_off

    @property
    def is_astray(self) -> bool:
        """Whether the arm does not follow, and is not trying to."""
        return bool(self._supervisor.astray) and not self._supervisor.tries

    @property
    def was_moved_in_silence(self) -> bool:
        """Whether the arm stands elsewhere than it stood when it was left alone."""
        there, posture = self._stood_at, self._supervisor.posture
        return (there is not None and posture is not None
                and bool((np.abs(posture - there) > _MOVED).any()))

    def look(self, now: float, told: Array | None, *, wishes: bool, tolerance: float) -> None:
        """Take the latest command and measurement.

        Args:
            now: [s].
            told: (n,) the velocities commanded last [rad/s, m/s]; None while the arm rests.
            wishes: whether somebody commands the arm.
            tolerance: how far a joint may be behind [rad, m]; 0 for any distance.
        """
        supervisor, following = self._supervisor, self._following
        if now - self._looked_at > _SLEPT:
            following.slept()
        self._looked_at = now
        supervisor.heard_a_wish(wishes, now, told is None)
        self._wished_at = now if wishes else self._wished_at
        if told is None:
            self._look_on(now)
            return
        self._silent_since, self._stood_at = np.inf, None
        posture = supervisor.posture
        assert posture is not None, 'the arm moves only after a measurement'
        following.tolerance = tolerance
        reason = following.tick(
            told, posture, supervisor.measurement_ages(now), tries=supervisor.tries)
        if reason and not self.is_astray:
            # One that moves is told nothing new: it might go astray on the way to where it is.
            self.anchor = None if following.moves_alone else posture
            supervisor.does_not_follow(f'{reason} {self._unheard()}'.rstrip())
        elif supervisor.tries and following.has_followed:
            supervisor.follows()
        if now - self._wished_at < FRESH_AFTER:
            following.rest()
            self._standing.leave()
        elif (self._standing.is_moved(now, told, posture)
              or following.moved_by_others > MOVED_BY_OTHERS):
            following.rest()
            self._standing.leave()
            supervisor.moved_by_others()

    def _look_on(self, now: float) -> None:
        """Note where an arm stands that is told nothing."""
        self._silent_since = min(self._silent_since, now)
        if self._stood_at is None and now - self._silent_since >= _SETTLES:
            self._stood_at = self._supervisor.posture

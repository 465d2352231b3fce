"""Where the arm is told to be, for controllers that take positions."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.planner import Planner
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.safety.position_command import PositionCommand
from redundant_planner.core.step_result import Nearest
from redundant_planner.nodes.arm_watch import ArmWatch

Array = npt.NDArray[np.float64]

# Less need not be kept clear of obstacles [m].
_LITTLE = 1e-3


class CommandedPositions:
    """The integral of the velocities, as far from the arm as its drives explain and no further."""

    def __init__(self, limits: Limits, period: float, watch: ArmWatch) -> None:
        """Begin without a posture.

        Args:
            limits: of the joints.
            period: of the commands [s].
            watch: knows how late the arm is, and where it stands if it does not follow.
        """
        self._command = PositionCommand(limits)
        self._period, self._watch = period, watch
        self._before: Array | None = None  # the last ones of an arm that does not follow
        self._stands_still = False  # whether they have come as near to a standing arm as they may

    def reset(self) -> None:
        """Start from the measured posture at the next motion."""
        self._command.reset()

    def start(self, posture: Array, tolerance: float) -> None:
        """Go on from a standing arm; from where it is if others have moved it."""
        if self._watch.was_moved_in_silence:
            self._command.reset()
        self._command.start(posture, tolerance)

    @property
    def are_back(self) -> bool:
        """Whether they have come back to where an arm stands that does not follow.

        A load may have pressed the arm beyond its range, where positions do not lead.
        """
        anchor = self._watch.anchor
        return anchor is None or self._stands_still or self._command.is_at(anchor)

    def next(
        self, dq: Array, lead: float, planner: Planner | None, nearest: Nearest | None,
    ) -> Array:
        """Return the positions (n,) that go with a command [rad, m].

        An arm that does not follow is where it was found. Otherwise positions may be ahead of
        the planned posture by what the drives explain, as long as no link gets nearer to an
        obstacle than it is.

        Args:
            dq: (n,) the velocities [rad/s, m/s].
            lead: how far positions may be ahead of a standing arm [rad, m].
            planner: knows the planned posture; None if the velocities alone count.
            nearest: the link that is nearest to an obstacle; None without one.
        """
        if self._watch.is_astray:
            anchor = self._watch.anchor
            positions = (self._command.advance(dq, self._period) if anchor is None
                         else self._command.come_back(anchor, self._period))
            self._stands_still = self._before is not None and bool(
                (positions == self._before).all())
            self._before = positions
            return positions
        self._before = None
        if planner is None:
            return self._command.advance(dq, self._period)
        most = lead + self._watch.travel
        if nearest is not None:
            reach = float((planner.robot.lever_arm_bounds @ most).max())
            most = most * min(1.0, max(nearest.beyond_margin, 0.0) / max(reach, _LITTLE))
        return self._command.advance(dq, self._period, planner.posture_ahead, most)

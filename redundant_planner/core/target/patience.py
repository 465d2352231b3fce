"""Whether an arm gets on along its way."""

from __future__ import annotations

import math

# An arm is stuck whose way has become shorter by less than this share of full speed for this
# long [s].
_LEAST_SPEED, PATIENCE = 0.01, 0.5


class Patience:
    """For how long a way has not become shorter.

    Attributes:
        spent: for so long [s].
    """

    def __init__(self) -> None:
        """Begin to watch a way."""
        self._left_then, self.spent = math.inf, 0.0

    @property
    def is_over(self) -> bool:
        """Whether the arm is stuck."""
        return self.spent >= PATIENCE

    def note(self, left: float, dt: float) -> None:
        """Note what is left of the way after a tick, both in s, at full speed."""
        if abs(self._left_then - left) > _LEAST_SPEED * PATIENCE:
            self._left_then, self.spent = left, 0.0
        else:
            self.spent += dt

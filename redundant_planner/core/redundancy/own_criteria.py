"""The criteria of the user's own in Eq. 18."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known
from redundant_planner.core.own_rules import Criterion, measured
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.step_result import OwnValue

Array = npt.NDArray[np.float64]


class OwnCriteria:
    """The user's criteria of one arm.

    Attributes:
        values: of all criteria at the last posture, NaN where one was not a finite number.
        fallbacks: what is said of those.
    """

    def __init__(self, n: int, criteria: Sequence[Criterion]) -> None:
        """Take the criteria of an arm of n joints, which have been checked."""
        self._criteria, self._none = tuple(criteria), np.zeros(n)
        self.values: tuple[OwnValue, ...] = ()
        self.fallbacks: list[str] = []

    def gradient(self, arm: Kinematics) -> Array:
        """Return their part of ∇H (n,), weights included; a broken one counts nothing."""
        if not self._criteria:
            return self._none
        total, values = np.zeros(len(self._none)), []
        for criterion in self._criteria:
            found = measured(criterion, arm)
            values.append(OwnValue(criterion.name, math.nan if found is None else found.value))
            if found is not None:
                total += criterion.weight * found.gradient
        self.values = tuple(values)
        broken = [name for name, value in values if math.isnan(value)]
        self.fallbacks = [
            f'without {known(broken)}, which is not a finite number'] if broken else []
        return total

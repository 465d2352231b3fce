"""What the joints shall do in a tick that is not the tip's."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.safety.stages import Request

Array = npt.NDArray[np.float64]


class JointMotion(NamedTuple):
    """What the joints shall do in a tick.

    Attributes:
        velocity: (n,) along the way [rad/s, m/s].
        feedback: (n,) back to it.
    """

    velocity: Array
    feedback: Array

    @property
    def wanted(self) -> Array:
        """Both together (n,)."""
        return self.velocity + self.feedback

    def request(self, q: Array, previous: Array) -> Request:
        """Return this for the filter, from a posture and the velocity of the last tick, (n,) each.

        A path of the joints is kept like one of the tip whose Jacobian is the identity.
        """
        n = len(q)
        return Request(
            self.wanted, np.zeros(n), np.eye(n), self.wanted, self.feedback, np.zeros(n), q,
            previous)

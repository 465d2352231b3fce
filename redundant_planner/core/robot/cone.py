"""How far an axis of the tip may lean away from a direction: a cup that is to stay upright."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, kernel, Matrix, Vector
from redundant_planner.core.robot import se3

Array = npt.NDArray[np.float64]


# An axis this near to the direction has none to lean to, and one this slow stands [rad, rad/s].
_UPRIGHT, _STANDS = 1e-6, 1e-6


class Cone(NamedTuple):
    """The cone that an axis of the tip stays in.

    Attributes:
        axis: (3,) unit vector in tip axes.
        direction: (3,) unit vector in the base frame.
        angle: half the opening of the cone, π for none [rad].
    """

    axis: Vector
    direction: Vector
    angle: float


@kernel
def _axis(cone: Cone, rotation: Matrix) -> Array:
    """Return the axis in the base frame (3,)."""
    a = np.zeros(3)
    for i in range(3):
        for k in range(3):
            a[i] += rotation[i, k] * cone.axis[k]
    return a


@compiled
def cone_room(cone: Cone, rotation: Matrix, screws: Matrix) -> tuple[float, Array]:
    """Return (cos θ − cos α)/sin α of an axis at an angle θ to the direction, and ∂/∂q (n,).

    At the cone's surface that is α − θ to first order, and it is smooth where θ is 0. The axis a
    turns with w_j × a, so ∂ cos θ/∂q_j = w_j · (a × d).

    Args:
        cone: with an angle α between 0 and π.
        rotation: (3, 3) tip axes in the base frame.
        screws: (6, n) of the joints, or the tip's Jacobian: their axes are the same, and count.
    """
    a, d = _axis(cone, rotation), cone.direction
    sine = math.sin(cone.angle)
    x = a[1] * d[2] - a[2] * d[1]
    y = a[2] * d[0] - a[0] * d[2]
    z = a[0] * d[1] - a[1] * d[0]
    gradient = np.empty(screws.shape[1])
    for j in range(len(gradient)):
        gradient[j] = (screws[3, j] * x + screws[4, j] * y + screws[5, j] * z) / sine
    leaning = a[0] * d[0] + a[1] * d[1] + a[2] * d[2]
    return (leaning - math.cos(cone.angle)) / sine, gradient


class Leaning(NamedTuple):
    """How the axis leans, and where to.

    Attributes:
        room: (2,) α − θ, and how far the axis can go on as it moves, along a great circle, until
            it leaves the cone; infinite where there is no such direction [rad].
        gradient: (2, n) ∂/∂q.
        change: (2,) rate of change of the first one's rate while the joints move on as they do,
            and 0 [rad/s²].
    """

    room: Vector
    gradient: Matrix
    change: Vector


@compiled
def leaning(cone: Cone, rotation: Matrix, screws: Matrix, dq: Vector) -> Leaning:
    """Return how much further the axis may lean, away from the direction and as it moves.

    The first alone lets an axis that comes through the middle of the cone be too fast to stop: its
    gradient turns about there. With ω = Σ w_j q̇_j the axis has ȧ = ω × a and
    ä = ω̇ × a + ω × (ω × a). Each joint axis turns with the joints before it, so
    ω̇ = Σ_j q̇_j (Σ_{k<j} w_k q̇_k) × w_j. From cos θ = a · d follows
    θ̈ = −(ä · d + cos θ θ̇²)/sin θ.

    Args:
        cone, rotation, screws: as of `cone_room`.
        dq: (n,) joint velocities.
    """
    a, d, n = _axis(cone, rotation), cone.direction, len(dq)
    found = Leaning(np.full(2, np.inf), np.zeros((2, n)), np.zeros(2))
    omega, change = np.zeros(3), np.zeros(3)
    for j in range(n):
        w = screws[3:, j].copy()
        change += dq[j] * se3.cross(omega, w)
        omega += dq[j] * w
    velocity = se3.cross(omega, a)
    second = se3.cross(change, a) + se3.cross(omega, velocity)
    cosine = min(max(np.sum(a * d), -1.0), 1.0)
    theta, sine = math.acos(cosine), math.sqrt(1.0 - cosine * cosine)
    speed = math.sqrt(np.sum(velocity * velocity))
    if sine > _UPRIGHT:
        found.room[0] = cone.angle - theta
        rate = -np.sum(velocity * d) / sine
        found.change[0] = (np.sum(second * d) + cosine * rate * rate) / sine
    if speed > _STANDS:
        found.room[1] = cone.angle + math.asin(
            min(max(np.sum(velocity * d) / speed, -1.0), 0.0))
    for j in range(n):
        along = se3.cross(screws[3:, j].copy(), a)
        if sine > _UPRIGHT:
            found.gradient[0, j] = np.sum(along * d) / sine
        if speed > _STANDS:
            found.gradient[1, j] = -np.sum(along * velocity) / speed
    return found

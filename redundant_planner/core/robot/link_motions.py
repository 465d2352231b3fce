"""How links move, and how that changes while the joints keep their velocities.

A link's twist is V = Σ_j s_j q̇_j over the joints that move it, with s_j their screws. Joint i
moves the screws of all joints beyond it, ds_j/dt = Σ_{i<j} q̇_i s_i × s_j, with the product of
screws [v; w] × [v'; w'] = [w × v' − w' × v; w × w'] (Featherstone, Rigid Body Dynamics
Algorithms, 2.9). So V̇ = Σ_j (Σ_{i<j} s_i q̇_i) × s_j q̇_j.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from redundant_planner.core.kernels import compiled, kernel, Matrix, Vector
from redundant_planner.core.robot.kinematics import Links
from redundant_planner.core.robot.se3 import Place


class LinkMotions(NamedTuple):
    """Twists of links, taken at the base origin.

    Attributes:
        twist: (c, 6) [v; w] [m/s, rad/s].
        change: (c, 6) its time derivative at constant joint velocities [m/s², rad/s²].
    """

    twist: Matrix
    change: Matrix


@compiled
def link_motions(links: Links, dq: Vector) -> LinkMotions:
    """Return how the links move with joint velocities (n,) [rad/s, m/s]."""
    count = len(links.start)
    twist, change = np.zeros((count, 6)), np.zeros((count, 6))
    for link in range(count):
        for j in range(len(dq)):
            speed = links.supports[link, j] * dq[j]
            if speed == 0.0:
                continue
            x, y, z, a, b, c = links.joint_screws[:, j]
            u, v, w, p, q, r = twist[link]
            change[link, 0] += speed * (q * z - r * y - b * w + c * v)
            change[link, 1] += speed * (r * x - p * z - c * u + a * w)
            change[link, 2] += speed * (p * y - q * x - a * v + b * u)
            change[link, 3] += speed * (q * c - r * b)
            change[link, 4] += speed * (r * a - p * c)
            change[link, 5] += speed * (p * b - q * a)
            for axis in range(6):
                twist[link, axis] += speed * links.joint_screws[axis, j]
    return LinkMotions(twist, change)


@kernel
def acceleration_of(motions: LinkMotions, link: int, point: Place) -> Place:
    """Return the acceleration of a link's point x: v̇ + ẇ × x + w × (v + w × x) [m/s²]."""
    x, y, z = point.x, point.y, point.z
    u, v, w, p, q, r = motions.twist[link]
    a, b, c, d, e, f = motions.change[link]
    along, across, up = u + q * z - r * y, v + r * x - p * z, w + p * y - q * x
    return Place(a + e * z - f * y + q * up - r * across,
                 b + f * x - d * z + r * along - p * up,
                 c + d * y - e * x + p * across - q * along)

"""Several tips that hold one object: where each is relative to the first, and what moves with it.

The first tip leads: its twist is the object's, taken at another point. The others keep their pose
relative to it, T_t = T_0 G_t. In the safety filter that is an equality of every stage,
(J_t − X_t J_0) q̇ = u k e_t: X_t takes a twist at the first tip to one at tip t, e_t is what tip t
is off by, and u ≤ 1 is as much as is possible of the way back.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot import se3
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.se3 import composed, Pose, Poses

Array = npt.NDArray[np.float64]


class Coupling(NamedTuple):
    """How tips hold an object together.

    Attributes:
        others: poses of the other tips in the first one's frame: G_t.
        held: the object's pose in the first tip's frame.
    """

    others: tuple[Pose, ...]
    held: Pose

    @classmethod
    def of(cls, tips: Poses, held: Pose | None = None) -> Coupling:
        """Couple tips where they are.

        Args:
            tips: their poses in the base frame.
            held: the object's pose there; half way between the tips and in base axes if None.
        """
        first, *others = tips.each
        held = Pose(tips.position.mean(axis=0), np.eye(3)) if held is None else held
        return cls(tuple(_relative(first, other) for other in others), _relative(first, held))

    def tips(self, first: Pose) -> Poses:
        """Return the poses of all tips where the first one has a given pose."""
        return Poses.of(first, *(composed(first, other) for other in self.others))

    def object_pose(self, first: Pose) -> Pose:
        """Return the object's pose where the first tip has a given pose."""
        return composed(first, self.held)

    def first_at(self, held: Pose) -> Pose:
        """Return the first tip's pose where the object has a given pose."""
        rotation = held.rotation @ self.held.rotation.T
        return Pose(held.position - rotation @ self.held.position, rotation)

    def first_twist(self, twist: Array, first: Pose, *, in_tool: bool) -> Array:
        """Return the first tip's twist (6,) that gives the object another one (6,).

        Args:
            twist: of the object [m/s, rad/s], in base axes, or the object's if `in_tool`.
            first: pose of the first tip.
            in_tool: whether the result is in the first tip's axes.
        """
        if in_tool:
            turned = se3.turned(twist, self.held.rotation)
            away = -self.held.position
        else:
            turned, away = twist, -first.rotation @ self.held.position
        return np.concatenate((turned[:3] + np.cross(turned[3:], away), turned[3:]))

    def twists(self, twist: Array, first: Pose, dt: float, *, in_tool: bool) -> Array:
        """Return the mean twists (6 t,) of all tips over a tick in which the first has its own.

        Args:
            twist: of the first tip (6,) in command axes [m/s, rad/s].
            first: its pose.
            dt: [s].
            in_tool: whether command axes are the tips'.
        """
        if in_tool:  # constant in the tip's axes: a screw motion
            return np.concatenate((twist, *(np.concatenate((
                other.rotation.T @ (twist[:3] + np.cross(twist[3:], other.position)),
                other.rotation.T @ twist[3:])) for other in self.others)))
        after = se3.integrate(first, twist, dt, False)
        now, then = self.tips(first), self.tips(after)
        moved = (then.position - now.position) / dt
        moved[0] = twist[:3]
        return np.hstack((moved, np.tile(twist[3:], (len(moved), 1)))).ravel()

    def rows(self, arm: Kinematics) -> Array:
        """Return J_t − X_t J_0 of the other tips, (6 (t − 1), n) in base axes."""
        return self._relative_twists(arm.tip_jacobian, arm.tip_positions)

    def relative(self, twists: Array, arm: Kinematics) -> Array:
        """Return the part (6 (t − 1),) of twists (6 t,) that changes relative poses, likewise."""
        return self._relative_twists(twists[:, None], arm.tip_positions)[:, 0]

    def _relative_twists(self, twists: Array, positions: Array) -> Array:
        """Return twists (6 t, k) of the other tips against what the first one's would be there."""
        first = twists[:6]
        found = []
        for t in range(1, len(positions)):
            x, y, z = positions[t] - positions[0]
            across = np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))  # w × (x_t − x_0)
            own = twists[6 * t:6 * t + 6]
            found.append(own[:3] - first[:3] - across @ first[3:])
            found.append(own[3:] - first[3:])
        return np.vstack(found)


def _relative(outer: Pose, inner: Pose) -> Pose:
    """Return a pose in the frame of another one."""
    return Pose(outer.rotation.T @ (inner.position - outer.position),
                outer.rotation.T @ inner.rotation)

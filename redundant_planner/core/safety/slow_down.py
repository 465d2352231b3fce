"""Slower near people: how fast the arm may be by its distance to certain obstacles.

An arm that is d away from an obstacle, and keeps d₀ from it at all times, has the time T to stop
if no point of it moves faster than (d − d₀)/T − v, with the obstacle's own speed v: the monitoring
of speed and separation of ISO/TS 15066, without its guarantees, as nothing here is safety-rated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.contacts import is_named
from redundant_planner.core.obstacles.inflation import inflated_obstacles, InflatedObstacles
from redundant_planner.core.obstacles.scene import Scene, selected
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]


class Separation(NamedTuple):
    """What may not be near to a fast arm.

    Attributes:
        name: of an obstacle, or what such names begin with.
        distance: that is kept at all times [m].
        time: in which the arm could stop [s].
    """

    name: str
    distance: float
    time: float


class _Limit(NamedTuple):
    """How fast the arm may be.

    Attributes:
        speed: of any point of it [m/s]; ∞ for any.
        obstacle: because of which.
        distance: of that one [m].
    """

    speed: float
    obstacle: str
    distance: float

    def __str__(self) -> str:
        """Return a phrase about it."""
        return (f"slower near '{self.obstacle}': {self.speed:.2f} m/s at "
                f'{self.distance:.2f} m')


_NONE = _Limit(np.inf, '', np.inf)


def separations_of(entries: Sequence[str]) -> tuple[Separation, ...]:
    """Return what the entries of a parameter say, 'name=distance:time' each.

    Raises:
        ParameterError: one says something else.
    """
    found = []
    for entry in entries:
        name, _, numbers = entry.rpartition('=')
        try:
            distance, time = map(float, numbers.split(':'))
        except ValueError:
            distance = time = np.nan
        if not (name and 0.0 <= distance < np.inf and 0.0 < time < np.inf):
            raise ParameterError(
                f"parameter 'slow_down' has '{entry}'; it takes 'name=distance:time': an obstacle "
                'or the namespace of markers, the distance [m] at which the arm stands still, and '
                "the time [s] in which it could stop, as 'person=0.3:0.5'")
        found.append(Separation(name, distance, time))
    return tuple(found)


class SlowDown:
    """Slows one arm down by its distance to what it shall be careful with."""

    def __init__(self, robot: Robot, entries: Sequence[str]) -> None:
        """Prepare; ParameterError as `separations_of`."""
        self._separations = separations_of(entries)
        self._robot = robot
        self._radii = [capsule.radius for capsule in robot.capsules]
        self._known: tuple[Scene, list[tuple[Separation, Scene, InflatedObstacles]]] | None = None

    def share(self, wanted: Array, scene: Scene, arm: Kinematics) -> tuple[float, str]:
        """Return the share of a motion that is not too fast.

        All joints slow down alike, and the path is kept. The share is taken before the safety
        filter acts: that brakes as the drives can, and what it adds to keep a clearance is not
        slowed down.

        Args:
            wanted: (n,) velocities.
            scene: the obstacles.
            arm: the posture.

        Returns:
            The share, and a phrase about what slows the arm down; empty where nothing does.
        """
        limit = self._limit(scene, arm)
        if limit is _NONE:
            return 1.0, ''
        speed = self._fastest(arm, wanted)
        if speed <= limit.speed:
            return 1.0, ''
        return limit.speed / speed, str(limit)

    def _limit(self, scene: Scene, arm: Kinematics) -> _Limit:
        slowest = _NONE
        for separation, part, maps in self._parts(scene):
            apart = link_clearance(maps, arm.segment_start, arm.segment_end).distance.min(axis=0)
            speeds = np.maximum(
                (apart - separation.distance) / separation.time - part.speeds, 0.0)
            i = int(speeds.argmin())
            if speeds[i] < slowest.speed:
                slowest = _Limit(float(speeds[i]), part.names[i], float(apart[i]))
        return slowest

    def _parts(self, scene: Scene) -> list[tuple[Separation, Scene, InflatedObstacles]]:
        if not self._separations or not self._radii:
            return []
        if self._known is None or self._known[0] is not scene:
            parts = [(separation, selected(scene, [
                i for i, name in enumerate(scene.names) if is_named(separation.name, name)]))
                for separation in self._separations]
            moved = self._robot.moved
            self._known = scene, [
                (separation, part, inflated_obstacles(part, self._radii, moved=moved))
                for separation, part in parts if part.names]
        return self._known[1]

    def _fastest(self, arm: Kinematics, dq: Array) -> float:
        """Return how fast the tip or an end of a link moves, at most [m/s]."""
        twists = (arm.joint_screws * dq @ self._robot.supports.T).T
        ends = [twists[:, :3] + np.cross(twists[:, 3:], end)
                for end in (arm.segment_start, arm.segment_end)]
        tips = (arm.tip_jacobian @ dq).reshape(-1, 6)[:, :3]
        points = np.vstack((*ends, tips))
        return float(np.sqrt((points * points).sum(axis=1)).max())

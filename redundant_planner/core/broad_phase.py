"""Which of many obstacles can matter for a while; the rest is not looked at.

A link's `distance` from an obstacle is 1-Lipschitz in its points (`core/obstacles.py`), and no
point of link c moves further than Σ_j lever_cj |Δq_j|. An obstacle that is further from every link
than a range therefore stays out of that link's reach as long as

    Σ_j lever_cj |q_j − q_j,then| ≤ range_c − reach_c          for every link c.

So does an obstacle that moves: its velocity counts in the reach, and a scene whose obstacles have
been moved is another scene.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.compiled import compiled, Indices, Matrix, Vector
from redundant_planner.core.obstacles import Pairs, Scene, Whitening

Array = npt.NDArray[np.float64]

# With fewer obstacles than this, looking at all of them is as quick.
FEW = 20
# How much further than needed one looks, so as not to look again soon [m].
_SLACK = 0.15


class Surroundings(NamedTuple):
    """The obstacles that can matter, and for how long.

    Attributes:
        scene: all obstacles.
        names: of those that can matter.
        maps: theirs.
        q: (n,) posture at which it was decided.
        range: (c,) distance that all others had from each link [m].
    """

    scene: Scene
    names: tuple[str, ...]
    maps: Whitening
    q: Array
    range: Array

    def hold(self, scene: Scene, q: Array, levers: Array, reach: Array) -> bool:
        """Return whether no other obstacle can be within reach at a posture.

        Args:
            scene: the obstacles now.
            q: (n,) posture now.
            levers: (c, n) of the links [m/rad, 1].
            reach: (c,) how near an obstacle must be to matter [m].
        """
        return scene is self.scene and _within(levers, q, self.q, reach, self.range)


@compiled
def _within(
    levers: Matrix, q: Vector, then: Vector, reach: Vector, limits: Vector,
) -> bool:
    for link in range(len(levers)):
        needed = reach[link]
        for j in range(len(q)):
            needed += levers[link, j] * abs(q[j] - then[j])
        if needed > limits[link]:
            return False
    return True


def surroundings(
    scene: Scene, maps: Whitening, pairs: Pairs, q: Array, reach: Array,
) -> Surroundings:
    """Choose the obstacles that are, or may soon be, within reach of a link.

    The nearest one is among them in any case.

    Args:
        scene, maps, pairs: all obstacles at the posture.
        q: (n,) the posture.
        reach: (c,) how near an obstacle must be to matter [m].
    """
    wide = reach + _SLACK
    index, near = _chosen(maps, pairs.distance, wide)
    return Surroundings(scene, tuple([scene.names[i] for i in index.tolist()]), near, q, wide)


@compiled
def _chosen(maps: Whitening, distance: Matrix, wide: Vector) -> tuple[Any, Whitening]:
    """Return which obstacles are within a distance of a link, or the nearest; and their maps."""
    links, count = distance.shape
    found, nearest, least = 0, 0, np.inf
    index: Indices = np.empty(count, np.intp)
    for obstacle in range(count):
        near = False
        for link in range(links):
            near = near or distance[link, obstacle] <= wide[link]
            if distance[link, obstacle] < least:
                nearest, least = obstacle, distance[link, obstacle]
        if near:
            index[found] = obstacle
            found += 1
    if found == 0:
        index[0], found = nearest, 1
    index = index[:found]
    inverse, smallest = np.empty((links, found, 3)), np.empty((links, found))
    for link in range(links):
        for i in range(found):
            inverse[link, i] = maps.inverse[link, index[i]]
            smallest[link, i] = maps.smallest[link, index[i]]
    return index, Whitening(maps.centers[index], maps.rotations[index], inverse, smallest,
                            maps.velocities[index], maps.speeds[index])

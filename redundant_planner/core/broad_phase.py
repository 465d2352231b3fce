"""Which of many obstacles can matter for a while; the rest is not looked at.

A link's `distance` from an obstacle is 1-Lipschitz in its points (`core/obstacles.py`), and no
point of link c moves further than Σ_j lever_cj |Δq_j|. An obstacle that is further from every link
than a range therefore stays out of that link's reach as long as

    Σ_j lever_cj |q_j − q_j,then| ≤ range_c − reach_c          for every link c.

So does an obstacle that moves: its velocity counts in the reach, and a scene whose obstacles have
been moved is another scene.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles import Pairs, Scene, Whitening

Array = npt.NDArray[np.float64]

# With fewer obstacles than this, looking at all of them is as quick.
FEW = 20
# How much further than needed one looks, so as not to look again soon [m].
_SLACK = 0.1


class Surroundings(NamedTuple):
    """The obstacles that can matter, and for how long.

    Attributes:
        scene: all obstacles.
        near: those that can matter.
        maps: theirs.
        q: (n,) posture at which it was decided.
        range: (c,) distance that all others had from each link [m].
    """

    scene: Scene
    near: Scene
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
        return scene is self.scene and bool(
            (levers @ np.abs(q - self.q) + reach <= self.range).all())


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
    chosen = np.asarray((pairs.distance <= wide[:, None]).any(axis=0))
    chosen[int(pairs.distance.min(axis=0).argmin())] = True
    index = np.flatnonzero(chosen)
    names = tuple(scene.names[i] for i in index.tolist())
    near = Scene(names, scene.centers[index], scene.rotations[index], scene.semi_axes[index],
                 scene.velocities[index])
    return Surroundings(scene, near, Whitening(
        maps.centers[index], maps.rotations[index],
        maps.inverse.take(index, axis=1), maps.smallest.take(index, axis=1),
        maps.velocities[index], maps.speeds[index]), q, wide)

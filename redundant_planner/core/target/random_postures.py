"""Random postures for trees to grow towards."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.target.tree_growth import Trees

Array = npt.NDArray[np.float64]

# How near to a posture of a tree, about [rad, m].
_NEAR_TREES = 0.9


def informed_samples(
    random: np.random.Generator, count: int, start: Array, goals: Array, most: Array,
    scaling: Array,
) -> Array:
    """Return postures (count, n) that lie on a way to a goal which is short enough.

    They fill the ellipsoid with its foci at the start and a goal, any one, evenly: other postures
    are on no such way (Gammell, Srinivasa and Barfoot 2014).

    Args:
        random: the numbers.
        count: how many postures.
        start: (n,) one end of a way.
        goals: (g, n) other ends, each nearer to the start than its `most`, g ≥ 1.
        most: (g,) how long a way to each may be [rad, joint weights included].
        scaling: (n,) 1 / square root of the joint weights.
    """
    n = len(start)
    goal = (random.random(count) * len(goals)).astype(np.intp)
    focus, other, longest = start / scaling, goals[goal] / scaling, most[goal, None]
    apart = np.linalg.norm(other - focus, axis=1, keepdims=True)
    # A goal at the start has no direction, and needs none: its ellipsoid is a ball.
    along = (other - focus) / np.where(apart > 0.0, apart, 1.0)
    ball = random.normal(size=(count, n))
    ball *= random.random((count, 1)) ** (1.0 / n) / np.linalg.norm(ball, axis=1, keepdims=True)
    across = 0.5 * np.sqrt(np.maximum(longest * longest - apart * apart, 0.0))
    longer = (0.5 * longest - across) * (ball * along).sum(axis=1, keepdims=True)
    return np.asarray(scaling * (0.5 * (focus + other) + across * ball + longer * along))


def near_trees(
    random: np.random.Generator, count: int, trees: Trees, low: Array, high: Array,
) -> Array:
    """Return postures (count, n) within joint ranges (n,), each near one of two trees in turn.

    Few motions lead out of a narrow place, and those towards far postures hardly ever do.
    """
    tree = np.arange(count) % 2
    node = (random.random(count) * trees.numbers[tree]).astype(np.intp)
    near = np.minimum(_NEAR_TREES, 0.5 * (high - low))
    return np.clip(random.normal(trees.postures[tree, node], near), low, high)

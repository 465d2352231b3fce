"""What the hand holds, as capsules that contain it."""

from __future__ import annotations

from collections.abc import Iterable
import itertools
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, ELLIPSOID, Obstacle
from redundant_planner.core.obstacles.scene import rotations
from redundant_planner.core.robot.capsules import Capsule

Array = npt.NDArray[np.float64]

# First part of the names of the capsules around what is held.
ATTACHED = 'attached'
# Every capsule costs time in every tick: so many at most for one thing, and for all that is held.
_MOST_PER_THING = 8
_MOST = 64
# Another capsule is worth it until they stand out this little from a box [m].
_ENOUGH = 0.01


class _Rod(NamedTuple):
    """A capsule along the longest axis of a thing.

    Attributes:
        sideways: (2,) where it is along the other two axes [m].
        half_length: of its segment [m].
        radius: [m].
    """

    sideways: tuple[float, float]
    half_length: float
    radius: float


def payload_capsules(things: Iterable[Obstacle], tip_frame: str) -> list[Capsule]:
    """Return capsules that contain things, at rest in the tip's frame.

    Args:
        things: in the tip's frame.
        tip_frame: its name.

    Raises:
        ObstacleError: a half-space cannot be held, and nor can more than the planner keeps an eye
            on.
    """
    capsules: list[Capsule] = []
    for thing in things:
        axes = rotations(thing.orientation[None])[0]
        order, rods = _rods(thing)
        for i, rod in enumerate(rods, 1):
            end = np.zeros(3)
            end[order] = rod.half_length, *rod.sideways
            start = end.copy()
            start[order[0]] = -rod.half_length
            name = f'{ATTACHED}/{thing.name}' + (f'/{i}' if len(rods) > 1 else '')
            capsules.append(Capsule(
                name, tip_frame, thing.center + axes @ start, thing.center + axes @ end,
                rod.radius))
    if len(capsules) > _MOST:
        raise ObstacleError(f'what is attached takes {len(capsules)} capsules; give fewer or '
                            f'simpler shapes: {_MOST} capsules at most')
    return capsules


def _rods(thing: Obstacle) -> tuple[list[int], list[_Rod]]:
    """Return capsules around a thing, and its axes in their order: theirs, and the other two.

    Raises:
        ObstacleError: it is a half-space.
    """
    a, b, c = thing.half_extents.tolist()
    if thing.shape == CAPSULE:
        return [2, 0, 1], [_Rod((0.0, 0.0), max(c - a, 0.0), a)]
    if thing.shape == CYLINDER:
        return [2, 0, 1], [_Rod((0.0, 0.0), *_around_cylinder(c, a))]
    order = np.argsort(-thing.half_extents, kind='stable').tolist()
    a, b, c = thing.half_extents[order].tolist()
    if thing.shape == ELLIPSOID:
        # Where the ellipse (a cos φ, b sin φ) is beyond the segment's end h, its distance from
        # there is no more than b if a cos φ − h ≤ b cos φ; h = a − b is the least that does.
        return order, [_Rod((0.0, 0.0), a - b, b)]
    if thing.shape == BOX:
        return order, _around_box(a, b, c)
    raise ObstacleError(f"attached '{thing.name}' is a {thing.shape}, which nothing can hold")


def _around_cylinder(half_height: float, radius: float) -> tuple[float, float]:
    """Return half length and radius of the smallest capsule about a cylinder's axis.

    A capsule of radius R contains the rims if h ≥ half_height − √(R² − r²). Its volume
    2π R² h + 4/3 π R³ is least where the derivative vanishes, or h does.
    """
    # With R = r √(1 + x²), h = half_height − r x: a few steps of a search along x are plenty.
    x = np.linspace(0.0, half_height / radius, 200)
    wide = radius * np.sqrt(1.0 + x * x)
    volume = 2.0 * wide ** 2 * (half_height - radius * x) + 4.0 / 3.0 * wide ** 3
    best = int(volume.argmin())
    # Round-off must not leave the rims outside.
    return max(half_height - radius * float(x[best]), 0.0), float(wide[best]) * (1.0 + 1e-12)


def _around_box(a: float, b: float, c: float) -> list[_Rod]:
    """Return capsules along the longest of a box's half extents a ≥ b ≥ c.

    The face across is cut into equal cells, each with a capsule around it. More cells let the
    round sides stand out less: as few as are good enough, or the best of those that may be.
    """
    def stands_out(cells: tuple[int, int]) -> float:
        half = b / cells[0], c / cells[1]
        return math.hypot(*half) - min(half)

    choices = [(along, across) for along, across in itertools.product(
        range(1, _MOST_PER_THING + 1), repeat=2) if along * across <= _MOST_PER_THING]
    good = [cells for cells in choices if stands_out(cells) <= _ENOUGH]
    along, across = (min(good, key=lambda cells: (math.prod(cells), stands_out(cells))) if good
                     else min(choices, key=stands_out))
    half_length, radius = _around_cylinder(a, math.hypot(b / along, c / across))
    return [_Rod((b * ((2 * i + 1) / along - 1.0), c * ((2 * j + 1) / across - 1.0)),
                 half_length, radius) for i in range(along) for j in range(across)]

"""Obstacles of any shape around an arm: small ones at rest, and crowds that move about."""

from __future__ import annotations

from collections.abc import Sequence
import itertools
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    Obstacle,
    SHAPES,
)
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

ALL_SHAPES = (ELLIPSOID, BOX, CYLINDER, CAPSULE)
SHAPE_NAMES = (*ALL_SHAPES, 'mixed')
KINDS = ('around', 'appearing', 'growing', 'closing in', 'wandering', 'crossing', 'cage',
         'slivers')
# Of those that move: they turn this fast [rad/s].
_TURNING = 0.5


def shapes_of(name: str) -> tuple[str, ...]:
    """Return the shapes that one of `SHAPE_NAMES` stands for."""
    return ALL_SHAPES if name == 'mixed' else (name,)


def fitted(kinds: Indices, sizes: Array) -> Array:
    """Return half extents (k, 3) that the shapes can have: round ones are as wide as deep [m].

    Args:
        kinds: (k,) indices into `SHAPES`.
        sizes: (k, 3) any half extents [m].
    """
    round_ones = np.isin(kinds, [SHAPES.index(CYLINDER), SHAPES.index(CAPSULE)])
    capsules = kinds == SHAPES.index(CAPSULE)
    result = sizes.copy()
    result[round_ones, 1] = result[round_ones, 0]
    result[capsules, 2] = np.maximum(result[capsules, 2], result[capsules, 0])
    return result


class Layout(NamedTuple):
    """What obstacles around a motion are like.

    Attributes:
        shapes: of them, in turn.
        clear_way: whether they keep off the motion and where it would lead if it went on, too.
    """

    shapes: tuple[str, ...] = (ELLIPSOID,)
    clear_way: bool = False


ELLIPSOIDS = Layout()


def obstacles_off(
    robot: Robot, postures: Array, count: int, extent: tuple[Sequence[float], Sequence[float]],
    shapes: tuple[str, ...],
) -> list[Obstacle]:
    """Return obstacles with half extents of 2 to 5 cm that keep 5 cm off postures (k, n).

    Args:
        robot: the arm.
        postures: (k, n) [rad, m].
        count: of the obstacles.
        extent: lowest and highest coordinates of their centres [m].
        shapes: of the obstacles, in turn; only ellipsoids keep to base axes.
    """
    random = np.random.default_rng(0)
    arms = robot.kinematics_along(postures)
    radii = [capsule.radius + 0.05 for capsule in robot.capsules]
    found: list[Obstacle] = []
    for first in itertools.count(step=count):
        if len(found) >= count:
            break
        drawn = np.array([(random.uniform(*extent), random.uniform(0.02, 0.05, 3))
                          for _ in range(count)])
        batch = _small_obstacles(shapes, drawn[:, 0], drawn[:, 1], random, first)
        clear = link_clearance(
            inflated_obstacles(Scene.of(batch), radii), arms.segment_start,
            arms.segment_end).normalized_distance.min(axis=(0, 1)) > 0.0
        found += [obstacle for obstacle, free in zip(batch, clear) if free]
    return found[:count]


def _small_obstacles(
    shapes: tuple[str, ...], centers: Array, sizes: Array, random: np.random.Generator,
    first: int,
) -> list[Obstacle]:
    """Return obstacles at rest, numbered from `first` on; ellipsoids keep to the base's axes.

    Args:
        shapes: one of them for each in turn.
        centers, sizes: (k, 3) centres and half extents [m].
        random: for orientations.
        first: number of the first.
    """
    found = []
    for i, (center, size) in enumerate(zip(centers, sizes), start=first):
        shape, (x, y, z) = shapes[i % len(shapes)], size.tolist()
        turn = np.array([0.0, 0.0, 0.0, 1.0])
        if shape != ELLIPSOID:
            turn = random.normal(size=4)
            turn /= np.linalg.norm(turn)
        if shape == BOX:
            found.append(Obstacle.box(f'o{i}', center, (2 * x, 2 * y, 2 * z), orientation=turn))
        elif shape == CYLINDER:
            found.append(Obstacle.cylinder(f'o{i}', center, x, 2 * z, orientation=turn))
        elif shape == CAPSULE:
            found.append(Obstacle.capsule(f'o{i}', center, x, 2 * z, orientation=turn))
        else:
            found.append(Obstacle(f'o{i}', center, size))
    return found


class Crowd:
    """Obstacles that are as inconvenient as their kind has it."""

    def __init__(
        self, kind: str, count: int, shapes: tuple[str, ...], random: np.random.Generator,
    ) -> None:
        """Prepare `count` obstacles of one of `KINDS`, of the given shapes in turn."""
        self._kind, self._random = kind, random
        self._names = tuple(f'o{i}' for i in range(count))
        self._shapes = np.array(
            [SHAPES.index(shapes[i % len(shapes)]) for i in range(count)], dtype=np.intp)
        self._away = random.normal(size=(count, 3))
        self._away /= np.linalg.norm(self._away, axis=1)[:, None] + 1e-9
        self._at = random.uniform(-1.0, 1.0, count)  # along the arm
        self._distance = random.uniform(0.12, 0.5, count)
        if kind in ('crossing', 'closing in'):
            self._distance += 0.5
        sizes = random.uniform(0.01, 0.05, (count, 3))
        if kind == 'slivers':
            sizes[:, 0] *= 20.0
        elif kind != 'growing':
            sizes[:] = sizes[:, :1] * random.uniform(0.7, 1.3, (count, 3))
        self._sizes = sizes
        self._turns = _rotations(random, count)
        speed = {'crossing': 0.4, 'closing in': 0.25, 'wandering': 0.1}.get(kind, 0.0)
        self._velocity = -speed * self._away
        if kind == 'wandering':
            self._velocity = speed * random.normal(size=(count, 3))
        self._turning = _TURNING * (speed > 0.0) * random.normal(size=(count, 3))
        self._centers: Array | None = None

    def scene(self, robot: Robot, q: Array, elapsed: float) -> Scene:
        """Return the obstacles at a posture and a time since the last scene [s]."""
        random, count = self._random, len(self._names)
        if not count:
            return Scene.of()
        around = self._centers is None or self._kind in ('appearing', 'around', 'cage')
        if around and (self._centers is None or random.random() < 0.3):
            arm = robot.kinematics(q)
            link = random.integers(len(arm.segment_start), size=count)
            share = random.uniform(0.0, 1.0, (count, 1))
            points = arm.segment_start[link] + share * (
                arm.segment_end[link] - arm.segment_start[link])
            distance = self._distance[:, None]
            if self._kind == 'cage':
                distance = 0.18 + 0.02 * random.random((count, 1))
            self._centers = points + distance * self._away
        assert self._centers is not None
        self._centers = self._centers + elapsed * self._velocity
        if self._kind == 'growing':
            self._sizes = np.minimum(self._sizes * 1.02, 0.3)
        chosen = np.arange(count)
        if self._kind == 'appearing':
            chosen = np.flatnonzero(random.random(count) < random.choice([0.0, 0.1, 0.5, 1.0]))
        kinds = self._shapes[chosen]
        return Scene(
            tuple([self._names[i] for i in chosen.tolist()]), kinds, self._centers[chosen],
            self._turns[chosen], fitted(kinds, self._sizes[chosen]), self._velocity[chosen],
            self._turning[chosen])


def _rotations(random: np.random.Generator, count: int) -> Array:
    """Return random rotation matrices (count, 3, 3)."""
    turned, upper = np.linalg.qr(random.normal(size=(count, 3, 3)))
    turned *= np.sign(np.diagonal(upper, axis1=1, axis2=2))[:, None, :]
    turned[:, :, 0] *= np.linalg.det(turned)[:, None]  # no reflections
    return np.asarray(turned)

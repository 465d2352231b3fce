"""Furniture of random size and place around the arm, and where a hand would go in it.

Everything is in the frame of the arm's base, on the floor z = 0. Furniture stands along x first
and then turns about the base.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]
Random = np.random.Generator

# Of boards and walls, half of it [m].
_THIN = 0.01
# From the hand's frame to between its fingertips [m].
_FINGERTIPS = 0.1


class Furniture(NamedTuple):
    """Obstacles, and where the hand goes among them.

    Attributes:
        obstacles: that stand still.
        hand: returns a random pose of the hand; it need be neither free nor within reach.
    """

    obstacles: tuple[Obstacle, ...]
    hand: Callable[[Random], Pose]


def table(random: Random) -> Furniture:
    """A table with things on it, which the hand reaches for from above."""
    depth, width, height = random.uniform((0.5, 0.8, 0.05), (0.8, 1.4, 0.4))
    near = random.uniform(0.25, 0.4)
    middle = np.array([near + 0.5 * depth, 0.0, height])
    parts = [_box('top', middle - [0, 0, _THIN], (depth, width, 2 * _THIN))]
    for i, (x, y) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
        at = middle + [0.45 * x * depth, 0.45 * y * width, -0.5 * height - _THIN]
        parts.append(Obstacle.cylinder(f'leg{i}', at, 0.025, max(height - 2 * _THIN, 0.02)))
    low, high = middle - [0.45 * depth, 0.45 * width, 0], middle + [0.3 * depth, 0.45 * width, 0]
    parts += _things(random, low, high, int(random.integers(2, 8)))

    def hand(random: Random) -> Pose:
        point = random.uniform(low, high) + [0.0, 0.0, random.uniform(0.03, 0.25)]
        return _hand_at(random, point, (0.0, 0.0, -1.0), 0.5)

    return _turned(random, Furniture(tuple(parts), hand))


def shelf(random: Random) -> Furniture:
    """A shelf that the hand reaches into from the front."""
    depth, width = random.uniform((0.2, 0.6), (0.35, 1.0))
    gap = random.uniform(0.28, 0.45)
    bays = int(random.integers(2, 4))
    near, low = random.uniform(0.4, 0.6), random.uniform(0.0, 0.25)
    middle = np.array([near + 0.5 * depth, 0.0, low])
    tall = bays * gap
    parts = [_box(f'board{i}', middle + [0, 0, i * gap], (depth, width, 2 * _THIN))
             for i in range(bays + 1)]
    for i, side in enumerate((-1.0, 1.0)):
        parts.append(_box(f'side{i}', middle + [0, side * 0.5 * width, 0.5 * tall],
                          (depth, 2 * _THIN, tall)))
    parts.append(_box('back', middle + [0.5 * depth, 0, 0.5 * tall], (2 * _THIN, width, tall)))
    for i in range(bays):
        floor = middle + [0.0, 0.0, i * gap + _THIN]
        reach = np.array([0.3 * depth, 0.4 * width, 0.0])
        parts += _things(random, floor - reach, floor + reach, int(random.integers(0, 3)), f'b{i}')

    def hand(random: Random) -> Pose:
        bay = random.integers(bays)
        point = middle + random.uniform((-0.5, -0.35, 0.3), (0.0, 0.35, 0.7)) * [
            depth, width, gap] + [0.0, 0.0, bay * gap]
        return _hand_at(random, point, (1.0, 0.0, 0.0), 0.4)

    return _turned(random, Furniture(tuple(parts), hand))


def box(random: Random) -> Furniture:
    """A box, open at the top, that the hand reaches down into."""
    size = random.uniform((0.3, 0.3, 0.1), (0.5, 0.6, 0.3))
    floor = random.uniform(0.02, 0.25)
    middle = np.array([random.uniform(0.3, 0.45) + 0.5 * size[0], 0.0, floor])
    parts = [_box('floor', middle, (size[0], size[1], 2 * _THIN)),
             Obstacle.cylinder('stand', middle - [0, 0, 0.5 * floor + _THIN], 0.1,
                               max(floor - 2 * _THIN, 0.01))]
    for axis in (0, 1):
        for i, side in enumerate((-1.0, 1.0)):
            at, extents = middle + [0.0, 0.0, 0.5 * size[2]], size.copy()
            at[axis] += 0.5 * side * size[axis]
            extents[axis] = 2 * _THIN
            parts.append(_box(f'wall{"xy"[axis]}{i}', at, extents))
    inside = np.array([0.35 * size[0], 0.35 * size[1], 0.0])
    bottom = middle + [0.0, 0.0, _THIN]
    parts += _things(random, bottom - inside, bottom + inside, int(random.integers(0, 3)))

    def hand(random: Random) -> Pose:
        point = bottom + random.uniform(-1.0, 1.0, 3) * inside
        point[2] += random.uniform(0.04, 0.3)
        return _hand_at(random, point, (0.0, 0.0, -1.0), 0.3)

    return _turned(random, Furniture(tuple(parts), hand))


def cage(random: Random) -> Furniture:
    """Bars in a ring around a spot, with a ring on top: the hand reaches in between them."""
    radius, tall = random.uniform((0.2, 0.3), (0.35, 0.7))
    bars, thick = int(random.integers(4, 8)), random.uniform(0.008, 0.02)
    middle = np.array([random.uniform(0.35, 0.5) + radius, 0.0, random.uniform(0.0, 0.2)])
    first = random.uniform(0.0, 2.0 * np.pi)
    around = first + 2.0 * np.pi * np.arange(bars) / bars
    feet = middle + radius * np.column_stack((np.cos(around), np.sin(around), np.zeros(bars)))
    parts = []
    for i in range(bars):
        top, following = feet[i] + [0.0, 0.0, tall], feet[(i + 1) % bars] + [0.0, 0.0, tall]
        parts += [_bar(f'bar{i}', feet[i], top, thick), _bar(f'ring{i}', top, following, thick)]
    parts += _things(random, middle - [0.1, 0.1, 0.0], middle + [0.1, 0.1, 0.0], 1)

    def hand(random: Random) -> Pose:
        point = middle + random.uniform((-0.5, -0.5, 0.3), (0.3, 0.5, 0.8)) * [
            radius, radius, tall]
        downwards = random.uniform(0.0, 1.0)
        return _hand_at(random, point, (1.0 - downwards, 0.0, -downwards), 0.5)

    return _turned(random, Furniture(tuple(parts), hand))


def walls(random: Random) -> Furniture:
    """Walls that stand on edge around the arm, a pipe across, and somewhere to point at."""
    parts = []
    for i in range(int(random.integers(2, 5))):
        angle, distance = random.uniform(-np.pi, np.pi), random.uniform(0.3, 0.7)
        at = np.array([distance * np.cos(angle), distance * np.sin(angle), 0.0])
        extents = random.uniform((0.02, 0.3, 0.2), (0.08, 0.9, 0.8))
        at[2] = 0.5 * extents[2] + random.uniform(0.0, 0.3)
        turn = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, angle + random.uniform(-0.8, 0.8)))
        parts.append(Obstacle.box(f'wall{i}', at, extents, orientation=turn.coeffs()))
    ends = random.uniform((-0.6, -0.9, 0.4), (0.8, 0.9, 1.1), (2, 3))
    parts.append(_bar('pipe', ends[0], ends[1], random.uniform(0.015, 0.05)))

    def hand(random: Random) -> Pose:
        angle, distance = random.uniform(-1.5, 1.5), random.uniform(0.3, 0.7)
        point = np.array([distance * np.cos(angle), distance * np.sin(angle),
                          random.uniform(0.1, 0.8)])
        return _hand_at(random, point, (np.cos(angle), np.sin(angle), random.uniform(-1.5, 0.2)),
                        0.6)

    return Furniture(tuple(parts), hand)


FAMILIES: dict[str, Callable[[Random], Furniture]] = {
    'table': table, 'shelf': shelf, 'box': box, 'cage': cage, 'walls': walls}


def _box(name: str, center: Array, size: npt.ArrayLike) -> Obstacle:
    return Obstacle.box(name, center, size)


def _bar(name: str, start: Array, end: Array, radius: float) -> Obstacle:
    """Return a capsule from one point to another."""
    along = end - start
    length = float(np.linalg.norm(along))
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along / length)
    return Obstacle.capsule(name, 0.5 * (start + end), radius, length, orientation=turn.coeffs())


def _things(
    random: Random, low: Array, high: Array, count: int, prefix: str = '',
) -> Iterator[Obstacle]:
    """Yield cans, parcels and balls that stand on a rectangle."""
    for i in range(count):
        spot, kind = random.uniform(low, high), random.integers(3)
        tall, wide = random.uniform((0.06, 0.02), (0.2, 0.06))
        if kind == 0:
            yield Obstacle.cylinder(f'{prefix}can{i}', spot + [0, 0, 0.5 * tall], wide, tall)
        elif kind == 1:
            yield Obstacle.box(
                f'{prefix}parcel{i}', spot + [0, 0, 0.5 * tall], (2 * wide, 3 * wide, tall),
                orientation=_about_z(random.uniform(-np.pi, np.pi)))
        else:
            yield Obstacle(f'{prefix}ball{i}', spot + [0, 0, wide], np.full(3, wide))


def _about_z(angle: float) -> Array:
    return np.array([0.0, 0.0, np.sin(0.5 * angle), np.cos(0.5 * angle)])


def _hand_at(random: Random, point: Array, pointing: npt.ArrayLike, tilt: float) -> Pose:
    """Return a hand with a point between its fingertips.

    Args:
        random: where from.
        point: (3,) [m].
        pointing: (3,) where the fingers point to, about.
        tilt: how far from there they may point, about [rad].
    """
    along = np.array(pointing, dtype=float)
    along = along / np.linalg.norm(along) + tilt * random.uniform(-0.5, 0.5, 3)
    along /= np.linalg.norm(along)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
    rotation = turn @ pin.rpy.rpyToMatrix(0.0, 0.0, random.uniform(-np.pi, np.pi))
    return Pose(point - _FINGERTIPS * along, rotation)


def _turned(random: Random, furniture: Furniture) -> Furniture:
    """Return furniture turned about the base by a random angle."""
    angle = random.uniform(-1.2, 1.2)
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, angle)

    def hand(random: Random) -> Pose:
        pose = furniture.hand(random)
        return Pose(turn @ pose.position, turn @ pose.rotation)

    return Furniture(tuple(_turned_obstacle(o, turn) for o in furniture.obstacles), hand)


def _turned_obstacle(obstacle: Obstacle, turn: Array) -> Obstacle:
    x, y, z = obstacle.half_extents.tolist()
    center = turn @ obstacle.center
    orientation = pin.Quaternion(turn @ obstacle.rotation).coeffs()
    if obstacle.shape == 'box':
        return Obstacle.box(obstacle.name, center, (2 * x, 2 * y, 2 * z), orientation=orientation)
    if obstacle.shape == 'cylinder':
        return Obstacle.cylinder(obstacle.name, center, x, 2 * z, orientation=orientation)
    if obstacle.shape == 'capsule':
        return Obstacle.capsule(obstacle.name, center, x, 2 * (z - x), orientation=orientation)
    return Obstacle(obstacle.name, center, (x, y, z), orientation)

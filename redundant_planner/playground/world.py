"""What stands around the arm on the page, and how it moves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
import math

from redundant_planner.core.errors import known, ObstacleError
from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, ELLIPSOID, Obstacle
from redundant_planner.io.obstacle_entries import obstacle_of

Numbers = tuple[float, ...]

# What can be added on the page.
ITEM_SHAPES = (ELLIPSOID, BOX, CYLINDER, CAPSULE)
# A page is for trying things around one arm [m].
FAR, SMALLEST, LARGEST = 3.0, 0.01, 3.0
MOST_ITEMS = 200
# How fast a thing may swing [m/s].
FASTEST = 2.0
# Of what is round about its z axis, the first two sizes are one.
_ROUND = (CYLINDER, CAPSULE)


@dataclass(frozen=True)
class Item:
    """One obstacle on the page.

    Attributes:
        name: what it is called, also as an obstacle.
        shape: one of `ITEM_SHAPES`.
        size: (3,) full extents [m].
        position: (3,) where it is, or the middle of its way if it moves [m].
        orientation: (4,) quaternion x y z w.
        swing: (3,) from the middle of its way to one end [m]; zeros if it stands still.
        period: of the motion to and fro [s].
    """

    name: str
    shape: str
    size: Numbers
    position: Numbers
    orientation: Numbers = (0.0, 0.0, 0.0, 1.0)
    swing: Numbers = (0.0, 0.0, 0.0)
    period: float = 4.0

    @property
    def moves(self) -> bool:
        """Whether it moves to and fro."""
        return any(self.swing)

    def place(self, time: float) -> Numbers:
        """Return where it is at a time [s]: (3,) [m]."""
        share = math.sin(2.0 * math.pi * time / self.period)
        return tuple(p + share * s for p, s in zip(self.position, self.swing))

    def obstacle(self, time: float) -> Obstacle:
        """Return it as an obstacle at a time [s], with its velocity.

        Raises:
            ObstacleError: it is none.
        """
        turn = 2.0 * math.pi / self.period
        speed = turn * math.cos(turn * time)
        return obstacle_of(self.name, {
            'shape': self.shape, 'size': list(self.size),
            'pose': [*self.place(time), *self.orientation],
            'velocity': [speed * s for s in self.swing]})


def checked(item: Item) -> Item:
    """Return an item within the bounds of the page.

    Raises:
        ObstacleError: a number is not finite, or the shape is unknown.
    """
    if item.shape not in ITEM_SHAPES:
        raise ObstacleError(f"obstacle '{item.name}': shape is '{item.shape}'; it must be one of "
                            f'{known(ITEM_SHAPES)}')
    for what, numbers, count in (
            ('size', item.size, 3), ('position', item.position, 3),
            ('orientation', item.orientation, 4), ('swing', item.swing, 3),
            ('period', (item.period,), 1)):
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            raise ObstacleError(f"obstacle '{item.name}': {what} is {list(numbers)}; it takes "
                                f'{count} finite numbers')
    size = [min(max(float(s), SMALLEST), LARGEST) for s in item.size]
    if item.shape in _ROUND:
        size[1] = size[0]
    if item.shape == CAPSULE:
        size[2] = max(size[2], size[0])
    swing = tuple(min(max(float(s), -FAR), FAR) for s in item.swing)
    length = math.hypot(*item.orientation)
    turned = tuple(float(q) / length for q in item.orientation) if 0.5 < length < 2.0 else (
        0.0, 0.0, 0.0, 1.0)
    return replace(
        item, size=tuple(size), swing=swing, orientation=turned,
        position=tuple(min(max(float(p), -FAR), FAR) for p in item.position),
        period=max(float(item.period), 2.0 * math.pi * math.hypot(*swing) / FASTEST, 0.1))


def item_name(obstacle: str) -> str:
    """Return the item's name from what the planner calls its marker: namespace/number."""
    return obstacle.removesuffix('/0')


class World:
    """All items on the page. `items` is a new mapping after each change."""

    def __init__(self, items: Iterable[Item] = ()) -> None:
        """Begin with some; ObstacleError as `checked`."""
        self._items = {item.name: checked(item) for item in items}

    @property
    def items(self) -> Mapping[str, Item]:
        """Name → item."""
        return self._items

    def add(self, shape: str, position: Numbers, size: Numbers = (0.1, 0.1, 0.1)) -> str:
        """Add an item; return the name that it got.

        Raises:
            ObstacleError: as `checked`, or there are too many.
        """
        if len(self._items) >= MOST_ITEMS:
            raise ObstacleError(f'there are {len(self._items)} obstacles; the page takes '
                                f'{MOST_ITEMS}: delete some')
        kind = 'ball' if shape == ELLIPSOID else shape
        number = 1
        while f'{kind} {number}' in self._items:
            number += 1
        item = checked(Item(f'{kind} {number}', shape, size, position))
        self._items = {**self._items, item.name: item}
        return item.name

    def change(self, item: Item) -> None:
        """Replace the item of the same name, if there is one; ObstacleError as `checked`."""
        if item.name in self._items:
            self._items = {**self._items, item.name: checked(item)}

    def remove(self, name: str) -> None:
        """Take an item away, if it is there."""
        self._items = {key: item for key, item in self._items.items() if key != name}

    def load(self, items: Iterable[Item]) -> None:
        """Replace all items; ObstacleError as `checked`, and nothing has changed then."""
        self._items = {item.name: checked(item) for item in items}

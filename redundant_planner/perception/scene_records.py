"""What is kept of a planning scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.perception.octree import Cubes
from redundant_planner.perception.scene_shapes import Solid

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class WorldObject(NamedTuple):
    """An object of the scene.

    Attributes:
        pose: (4, 4) in the base frame.
        solids: its shapes.
    """

    pose: Array
    solids: tuple[Solid, ...]


class HeldObject(NamedTuple):
    """An object that is attached to a link.

    Attributes:
        link: of the robot.
        pose: (4, 4) in the link's frame.
        solids: its shapes.
        touch_links: links that it may touch.
    """

    link: str
    pose: Array
    solids: tuple[Solid, ...]
    touch_links: tuple[str, ...]


class Voxels(NamedTuple):
    """The octomap.

    Attributes:
        pose: (4, 4) of the map in the base frame.
        cubes: the occupied ones.
    """

    pose: Array
    cubes: Cubes


class ContactMatrix(NamedTuple):
    """Which pairs of links and objects may touch.

    Attributes:
        places: name → its row and column.
        allowed: (k, k) whether a pair may touch.
        defaults: name → whether it may touch those that are not in the matrix together with it.
    """

    places: Mapping[str, int]
    allowed: Flags
    defaults: Mapping[str, bool]

    def allows(self, one: str, other: str) -> bool:
        """Return whether two may touch; where two defaults differ, they may not."""
        if one in self.places and other in self.places:
            return bool(self.allowed[self.places[one], self.places[other]])
        said = [self.defaults[name] for name in (one, other) if name in self.defaults]
        return bool(said) and all(said)


@dataclass(frozen=True)
class PlanningScene:
    """What is around the arm, and in its hand.

    Attributes:
        objects: id → object of the world.
        held: id → object that is attached.
        voxels: the octomap, None for none.
        matrix: who may touch whom.
        fixed: frames that the scene says itself: name → parent, and pose (4, 4) in that.
    """

    objects: Mapping[str, WorldObject] = field(default_factory=dict)
    held: Mapping[str, HeldObject] = field(default_factory=dict)
    voxels: Voxels | None = None
    matrix: ContactMatrix | None = None
    fixed: Mapping[str, tuple[str, Array]] = field(default_factory=dict)


class Surroundings(NamedTuple):
    """What a message is read with.

    Attributes:
        frame: returns the pose (4, 4) of a frame in the base frame as it is now, or raises
            ObstacleError with the reason; '' is the base frame.
        center: (3,) of a ball in the base frame that the arm does not leave [m].
        radius: of that ball, with all that is of interest around it [m].
    """

    frame: Callable[[str], Array]
    center: Array
    radius: float


def same_entries(one: Mapping[str, object], other: Mapping[str, object]) -> bool:
    """Return whether two have the very same entries."""
    return one.keys() == other.keys() and all(one[name] is other[name] for name in one)


def alike(one: HeldObject, other: HeldObject) -> bool:
    """Return whether two objects are attached alike."""
    return (one.link == other.link and one.touch_links == other.touch_links
            and np.array_equal(one.pose, other.pose) and len(one.solids) == len(other.solids)
            and all(a.kind == b.kind and np.array_equal(a.size, b.size)
                    and np.array_equal(a.in_object, b.in_object)
                    for a, b in zip(one.solids, other.solids)))

"""Contacts that are meant: which links may touch which obstacles, and what touches now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, ParameterError
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.shapes import HALF_SPACE
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.payload import ATTACHED

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class Contact(NamedTuple):
    """A link and an obstacle that touch.

    Attributes:
        link, obstacle: their names.
        depth: how far one is inside the other [m].
        allowed: whether that is meant.
    """

    link: str
    obstacle: str
    depth: float
    allowed: bool

    def __str__(self) -> str:
        """Return a sentence about it."""
        what = (f"link '{self.link}' touches obstacle '{self.obstacle}', "
                f'{1e3 * self.depth:.0f} mm deep: ')
        if self.allowed:
            return what + 'this contact is allowed, but may not get deeper'
        return what + ("the arm moves out of it as soon as it may move; if it is meant, add "
                       f"'{self.link}:{self.obstacle}' to allowed_contacts")


class AllowedContacts:
    """The pairs of links and obstacles that may touch.

    An entry 'link:obstacle' names a capsule or the URDF link that it belongs to, and an obstacle.
    Either may be the part of a name before a '/': of markers that is their namespace.
    """

    def __init__(self, entries: Sequence[str], robot: Robot) -> None:
        """Look the links up; those that no joint moves may touch anything as it is.

        Raises:
            ParameterError: an entry names a link that there is not.
        """
        self._rows: list[tuple[str, Flags]] = []
        for entry in entries:
            link, _, obstacle = entry.partition(':')
            rows = np.array([is_named(link, c.name) or link == c.frame for c in robot.capsules],
                            dtype=bool)
            if not rows.any() and link not in robot.links_at_rest and not is_named(ATTACHED, link):
                links = dict.fromkeys(name for c in robot.capsules for name in (c.frame, c.name)
                                      if not is_named(ATTACHED, c.name))
                raise ParameterError(
                    f"parameter 'allowed_contacts' has '{entry}'; the arm has no link '{link}' "
                    f"with a shape; '{ATTACHED}' is what it holds, and its own are "
                    f'{known(links)}')
            self._rows.append((obstacle, rows))
        self._count = len(robot.capsules)
        self._known: tuple[tuple[str, ...], Flags] | None = None

    def among(self, names: tuple[str, ...]) -> Flags | None:
        """Return which links may touch obstacles of these names, (c, k); None for no pair."""
        if not self._rows:
            return None
        if self._known is None or self._known[0] != names:
            flags = np.zeros((self._count, len(names)), bool)
            for obstacle, rows in self._rows:
                flags |= rows[:, None] & np.array([is_named(obstacle, n) for n in names], bool)
            self._known = names, flags
        return self._known[1]


def is_named(part: str, name: str) -> bool:
    """Return whether a name is this one, or one within it: 'person' has 'person/3'."""
    return name == part or name.startswith(f'{part}/')


def contacts(
    robot: Robot, arm: Kinematics, scene: Scene, allowed: AllowedContacts,
) -> tuple[Contact, ...]:
    """Return the deepest contact of every link and name of an obstacle, at one posture.

    Links may be beyond the walls of a workspace.

    Args:
        robot: the arm.
        arm: where its links are.
        scene: the obstacles.
        allowed: which pairs may touch.
    """
    capsules = robot.capsules
    if not scene.names or not capsules:
        return ()
    pairs = link_clearance(
        inflated_obstacles(scene, [c.radius for c in capsules], moved=robot.moved),
        arm.segment_start, arm.segment_end, enough=0.0)
    may_touch = np.tile(scene.shapes == HALF_SPACE, (len(capsules), 1))
    flags = allowed.among(scene.names)
    if flags is not None:
        may_touch |= flags
    deepest: dict[tuple[str, str], Contact] = {}
    for link, obstacle in np.argwhere(pairs.distance < 0.0).tolist():
        found = Contact(capsules[link].name, scene.names[obstacle],
                        -float(pairs.distance[link, obstacle]),
                        bool(may_touch[link, obstacle]))
        key = found.link, found.obstacle
        if key not in deepest or deepest[key].depth < found.depth:
            deepest[key] = found
    return tuple(deepest.values())

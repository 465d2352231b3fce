"""MoveIt's allowed collision matrix and touch links as the planner's `allowed_contacts`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from redundant_planner.core.errors import known, ObstacleError
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.payload import ATTACHED
from redundant_planner.perception.scene_records import ContactMatrix, HeldObject

# Entries that are handed on: the planner compares each with every name of an obstacle.
MOST_ENTRIES = 200


class Allowed(NamedTuple):
    """What becomes of a matrix.

    Attributes:
        entries: for `allowed_contacts`, in alphabetical order.
        remarks: a sentence for each pair that is none there.
    """

    entries: tuple[str, ...]
    remarks: tuple[str, ...]


def matrix_of(message: Any) -> ContactMatrix:
    """Return a moveit_msgs/AllowedCollisionMatrix.

    Raises:
        ObstacleError: its lists are not of the lengths that belong together.
    """
    names, defaults = list(message.entry_names), list(message.default_entry_names)
    rows = [list(entry.enabled) for entry in message.entry_values]
    if len(rows) != len(names) or any(len(row) != len(names) for row in rows):
        raise ObstacleError(f'has {len(names)} names and rows of the lengths '
                            f'{sorted({len(row) for row in rows})}, {len(rows)} of them; it takes '
                            'as many rows as names, each as long')
    if len(message.default_entry_values) != len(defaults):
        raise ObstacleError(f'has {len(defaults)} names of defaults and '
                            f'{len(message.default_entry_values)} values; it takes one for each')
    return ContactMatrix(
        {name: i for i, name in enumerate(names)},
        np.array(rows, dtype=bool).reshape(len(names), len(names)),
        dict(zip(defaults, map(bool, message.default_entry_values))))


def allowed_contacts(
    matrix: ContactMatrix | None, things: Iterable[str], held: Mapping[str, HeldObject],
    robot: Robot,
) -> Allowed:
    """Return which contacts with obstacles the planner is to allow.

    Args:
        matrix: None for none.
        things: ids of the obstacles.
        held: id → attached object; those that do not move along with the tip are obstacles, too.
        robot: the arm.
    """
    things = sorted(things)
    links = sorted({capsule.frame for capsule in robot.capsules}
                   & set(robot.moving_links))
    of_tip = robot.links_of_tip
    remarks: list[str] = []
    pairs: list[tuple[str, str]] = []
    in_hand = sorted(name for name, one in held.items() if one.link in of_tip)
    for thing in things:
        touch = held[thing].touch_links if thing in held else ()
        pairs += [(link, thing) for link in links
                  if link in touch or (matrix is not None and matrix.allows(link, thing))]
        if matrix is not None:
            pairs += [(f'{ATTACHED}/{name}', thing) for name in in_hand
                      if matrix.allows(name, thing)]
    entries = []
    for link, thing in pairs:
        # A name stands for all that begin with it and a '/', and the first ':' ends the link's.
        wider = [name for names, own in ((things, thing), (in_hand, link.partition('/')[2]))
                 for name in names if own and name.startswith(f'{own}/')]
        if ':' in link or not thing or wider:
            remarks.append(
                f'object {thing!r} may touch {link!r}, which allowed_contacts cannot say: '
                + (f'it would allow {known(wider)}, too' if wider else
                   "the first ':' of an entry ends the name of the link" if thing else
                   'the object has no name'))
        else:
            entries.append(f'{link}:{thing}')
    for name in in_hand:
        others = [link for link in links if link not in of_tip and (
            link in held[name].touch_links
            or (matrix is not None and matrix.allows(link, name)))]
        if others:
            remarks.append(f'object {name!r} is held and may touch links that do not move along '
                           f'with the tip: the planner keeps it from {known(others)} all the same')
    if matrix is not None:
        remarks += _own_pairs(matrix, robot)
    if len(entries) > MOST_ENTRIES:
        remarks.append(f'the scene allows too many contacts: {MOST_ENTRIES} of {len(entries)} '
                       f'are handed on, not those from {entries[MOST_ENTRIES]!r} on')
    return Allowed(tuple(sorted(entries[:MOST_ENTRIES])), tuple(remarks))


def _own_pairs(matrix: ContactMatrix, robot: Robot) -> list[str]:
    """Return a sentence about pairs of the arm's own links that the planner keeps apart."""
    frames = [capsule.frame for capsule in robot.capsules]
    pairs = dict.fromkeys(
        f'{frames[i]}:{frames[j]}' for i, j in robot.self_pairs.tolist()
        if frames[i] != frames[j] and matrix.allows(frames[i], frames[j]))
    return ['pairs of own links that may touch are not handed on: the planner keeps '
            f'{known(pairs)} apart all the same'] if pairs else []

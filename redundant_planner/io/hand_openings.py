"""Where the links of a hand may be: its joints move, though the planner holds them still.

The capsules of an arm whose fingers are shut would let go of an open hand's sides. So they are
fitted around the links that hang from the last joint of the chain wherever the hand's own joints
take them, all of them opening and closing together.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.urdf import Joint, MOVABLE, read_urdf

Array = npt.NDArray[np.float64]

# Positions of a joint that turns which are looked at, and of one that slides.
_TURNING, _SLIDING = 17, 2
# A joint that turns further than this is no finger's [rad], nor one that slides further [m].
_LARGEST_TURN, _LARGEST_SLIDE = math.pi, 0.5


class Openings(NamedTuple):
    """The hand of an arm at several openings.

    Attributes:
        joints: that open it, those that follow others left out; empty for a hand that is still.
        links: that they move.
        robots: the arm with its hand opened further and further, or the arm as it is.
    """

    joints: tuple[str, ...]
    links: frozenset[str]
    robots: tuple[Robot, ...]

    def points_of(self, base: str, link: str, points: Array) -> tuple[Array, float]:
        """Return where points (k, 3) of a link come, (m, 3) in another one's frame.

        Also by how much they may come out of the hull of these between two openings [m].
        """
        robots = self.robots if link in self.links else self.robots[:1]
        places = np.array([robot.in_link(base, link, points) for robot in robots])
        axes = [robot.in_link(base, link, np.eye(3)) - robot.in_link(base, link, np.zeros((1, 3)))
                for robot in robots]
        bulge = 0.0
        for here, there, one, other in zip(places, places[1:], axes, axes[1:]):
            turn = math.acos(min(max(0.5 * (float((one * other).sum()) - 1.0), -1.0), 1.0))
            chord = float(np.linalg.norm(there - here, axis=1).max())
            bulge = max(bulge, 0.5 * chord * math.tan(0.25 * turn))
        return places.reshape(-1, 3), bulge


def openings_of(robot: Robot, held: Mapping[str, float]) -> Openings:
    """Return an arm with its hand at all openings.

    Joints that somebody has locked at a position stay there, as do those that turn or slide so far
    that they are no fingers'.

    Args:
        robot: the arm, its capsules do not matter.
        held: joint name → where it is locked [rad, m].
    """
    described = {joint.name: joint for joint in read_urdf(robot.urdf).joints}
    above = {joint.child: joint for joint in described.values()}
    chain = set(robot.joint_names)
    hands = {robot.model.names[int(joint)] for joint in robot.chain.tip_joints}
    moves: dict[str, list[Joint]] = {}
    for link, carrier in robot.moving_links.items():
        if carrier in hands:
            at, path = link, []
            while at in above and above[at].name not in chain:
                path.append(above[at])
                at = above[at].parent
            moves[link] = [joint for joint in path if joint.kind in MOVABLE]
    leaders = {joint.name if joint.mimic is None else joint.mimic.leader
               for path in moves.values() for joint in path}
    joints = tuple(name for name in described if name in leaders and name not in chain
                   and name not in held and _is_fingers(described[name]))
    links = frozenset(link for link, path in moves.items() if any(
        (joint.name if joint.mimic is None else joint.mimic.leader) in joints for joint in path))
    if not joints:
        return Openings((), frozenset(), (robot,))
    turns = any(joint.kind != 'prismatic' for path in moves.values() for joint in path)
    return Openings(joints, links, tuple(
        Robot(robot.urdf, tips=robot.tips, base_frame=robot.base_frame,
              locked_positions={**held, **{
                  name: float((1.0 - share) * described[name].lower
                              + share * described[name].upper) for name in joints}},
              velocity_max=robot.velocity_max, capsules=[])
        for share in np.linspace(0.0, 1.0, _TURNING if turns else _SLIDING)))


def _is_fingers(joint: Joint) -> bool:
    """Return whether a joint moves no further than a finger's."""
    largest = _LARGEST_SLIDE if joint.kind == 'prismatic' else _LARGEST_TURN
    return joint.kind in MOVABLE and 0.0 < joint.upper - joint.lower <= largest

"""Which links of a URDF are probably the end effectors of its arms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import NamedTuple

from redundant_planner.core.robot.urdf import Joint, read_urdf

# What forks after this many joints is a hand.
_ARM_JOINTS = 6
# Arms of a body with several have as many at least, and no finger is as long [m].
_SHORTEST_ARM, _LONGEST_FINGER = 5, 0.3


def likely_tip(urdf: str) -> str:
    """Return the link that is probably the end effector.

    It lies at the end of the chain with the most movable joints, or before the hand: where,
    after six joints or more, several joints hang from one link or a joint mimics another.

    Raises:
        RobotError: the URDF does not describe a robot.
    """
    described = read_urdf(urdf)
    return _likely_end(described.root, _joints_below(described.joints)).tip


def likely_tips(urdf: str) -> tuple[str, ...]:
    """Return the links that are probably the end effectors of a body with several arms.

    Arms are chains of five joints or more, and longer than fingers, that fork from one link. Of
    several such links it is the one that is furthest from the root: legs fork before it.

    Returns:
        One for each arm; none if there are not two.

    Raises:
        RobotError: the URDF does not describe a robot.
    """
    described = read_urdf(urdf)
    below = _joints_below(described.joints)
    found: tuple[str, ...] = ()
    links = [described.root]
    for link in links:  # grows meanwhile
        arms = []
        for joint in below.get(link, ()):
            links.append(joint.child)
            arm = _likely_end(joint.child, below, count=int(joint.kind != 'fixed'))
            if arm.joints >= _SHORTEST_ARM and arm.length > _LONGEST_FINGER:
                arms.append(arm.tip)
        found = tuple(arms) if len(arms) > 1 else found
    return found


def _joints_below(joints: Sequence[Joint]) -> dict[str, list[Joint]]:
    """Return link → the joints that hang from it."""
    below: dict[str, list[Joint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    return below


class _End(NamedTuple):
    """Where a chain ends.

    Attributes:
        joints: how many movable ones lead there.
        tip: the link.
        length: of the chain, from joint to joint [m].
    """

    joints: int
    tip: str
    length: float


def _likely_end(first: str, below: Mapping[str, Sequence[Joint]], count: int = 0) -> _End:
    """Return where the longest chain from a link ends, before its hand.

    Args:
        first: the link.
        below: link → the joints that hang from it.
        count: of the movable joints before it.
    """
    order = [_End(count, first, 0.0)]
    for link in order:  # grows meanwhile: every link comes after the one that it hangs from
        for joint in below.get(link.tip, ()):
            order.append(_End(link.joints + (joint.kind != 'fixed'), joint.child,
                              link.length + math.hypot(*joint.xyz)))
    # The end that each link leads to, and how many joints lie before it.
    ends: dict[str, _End] = {}
    for link in reversed(order):
        best, branches = link, below.get(link.tip, ())
        several = sum(joint.kind != 'fixed' for joint in branches) > 1
        if link.joints < _ARM_JOINTS or not (
                several or any(joint.mimic is not None for joint in branches)):
            for joint in branches:
                found = ends[joint.child]
                if joint.mimic is None and (
                        found.joints > best.joints
                        or (found.joints == best.joints and joint.kind == 'fixed')):
                    best = found
        ends[link.tip] = best
    return ends[first]

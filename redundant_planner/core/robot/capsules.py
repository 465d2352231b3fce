"""Link shapes: capsules, how fast their points can move, and which of them can collide."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.errors import known, ObstacleError, RobotError, shown
from redundant_planner.core.numbers import floats_of
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.pinocchio_model import link_id, link_names
from redundant_planner.core.robot.urdf import LARGEST

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

# No arm has more capsules: every one of them costs time in every tick.
_MOST_CAPSULES = 500
# How many random postures decide which links can collide. Links that overlap in more than this
# share of them do so by construction; links two joints apart that never get nearer than this [m]
# cannot collide.
_SAMPLED_POSTURES = 500
_LARGEST_OVERLAP_SHARE = 0.25
_NEVER_NEARER = 0.02
# How many of them decide about what the hand holds, while the arm may be moving.
_POSTURES_OF_PAYLOAD = 100


@dataclass(frozen=True, init=False)
class Capsule:
    """A link's shape: every point within `radius` of a segment. Its arrays are read-only.

    Attributes:
        name: what messages call it; usually the link's name.
        frame: URDF link (or Pinocchio frame) that the end points are fixed to.
        start: (3,) first end of the segment in `frame` [m].
        end: (3,) second end of the segment in `frame` [m]; may equal `start`.
        radius: [m], 0 for a bare segment.
    """

    name: str
    frame: str
    start: Array
    end: Array
    radius: float

    def __init__(
        self, name: str, frame: str, start: npt.ArrayLike, end: npt.ArrayLike, radius: float,
    ) -> None:
        """Check the numbers; the class says what they are.

        Raises:
            ObstacleError: an end point is not three finite numbers, or the radius is negative.
        """
        object.__setattr__(self, 'name', name)
        object.__setattr__(self, 'frame', frame)
        for field, given in (('start', start), ('end', end)):
            point = floats_of(given)
            if point.shape != (3,) or not (np.abs(point) <= LARGEST).all():
                raise ObstacleError(
                    f"capsule '{name}': {field} is {shown(given)}; it takes three coordinates "
                    f'within ±{LARGEST:g} [m]')
            point.setflags(write=False)
            object.__setattr__(self, field, point)
        thickness = floats_of(radius)
        if thickness.shape != () or not 0.0 <= thickness <= LARGEST:
            raise ObstacleError(f"capsule '{name}': radius is {shown(radius)}; it must lie in "
                                f'[0, {LARGEST:g}] [m]')
        object.__setattr__(self, 'radius', float(thickness))


def straight_capsules(
    model: pin.Model, tip_ids: Sequence[int], radius: float | None,
) -> list[Capsule]:
    """Return straight capsules from each joint's origin to the next ones', the last ones to tips.

    Joints that share an origin have no link between them. They get a capsule only if the radius
    is positive.

    Raises:
        RobotError: there is no radius.
    """
    if radius is None:
        raise RobotError("the links have no shapes: give 'capsules', or 'link_radius' for "
                         'straight ones [m], 0 for bare lines')
    ends: dict[str, list[Array]] = {name: [] for name in tuple(model.names)[1:]}
    for joint in range(1, model.njoints):
        if model.parents[joint]:
            ends[model.names[model.parents[joint]]].append(
                np.array(model.jointPlacements[joint].translation))
    for tip in tip_ids:
        frame = model.frames[tip]
        ends[model.names[frame.parentJoint]].append(np.array(frame.placement.translation))
    return [Capsule(f'{name}_link' + (f'/{i}' if i else ''), name, np.zeros(3), end, radius)
            for name, others in ends.items() for i, end in enumerate(others)
            if radius > 0.0 or np.any(end != 0.0)]


def placed(model: pin.Model, capsules: Sequence[Capsule]) -> tuple[Indices, Array]:
    """Return the joints (c,) that carry the capsules, and their ends (c, 3, 2) there [m].

    Raises:
        RobotError: the robot has no frame of a capsule's, or there are too many capsules.
    """
    if len(capsules) > _MOST_CAPSULES:
        raise RobotError(f'{len(capsules)} capsules are more than the planner can keep '
                         f'an eye on; give {_MOST_CAPSULES} at most')
    joints, ends = [], []
    for capsule in capsules:
        if not model.existFrame(capsule.frame):
            raise RobotError(
                f"capsule '{capsule.name}': the robot has no frame '{capsule.frame}'; "
                f'it has {known(link_names(model))}')
        frame = model.frames[link_id(model, capsule.frame)]
        joints.append(frame.parentJoint)
        ends.append(np.column_stack(
            [frame.placement.act(np.array(end)) for end in (capsule.start, capsule.end)]))
    return np.array(joints, dtype=np.intp), np.array(ends).reshape(-1, 3, 2)


def supports_of(joints: Indices, parents: Indices) -> Array:
    """Return 1 where a joint moves what another one carries, else 0, (c, n).

    Args:
        joints: (c,) the joints that carry it, counted from 1; 0 for the base.
        parents: (n,) see `Chain`.
    """
    moves = np.zeros((len(parents) + 1, len(parents)))
    for j, before in enumerate(parents):
        moves[j + 1] = moves[before]
        moves[j + 1, j] = 1.0
    return moves[joints]


def joints_between(one: Indices, other: Indices, parents: Indices) -> Indices:
    """Return how many joints move one of two capsules against the other, (p,).

    Args:
        one, other: (p,) the joints that carry them, see `supports_of`.
        parents: (n,) see `Chain`.
    """
    apart = supports_of(one, parents) != supports_of(other, parents)
    return np.count_nonzero(apart, axis=1)


def lever_arm_bounds(model: pin.Model, capsule_joint: Indices, capsule_ends: Array) -> Array:
    """Bound how fast the points of a capsule move per unit of joint velocity, (c, n).

    A point is no further from a joint than all lengths of the chain after it, whatever the
    posture.

    Args:
        model: the chain.
        capsule_joint, capsule_ends: from `placed`.

    Returns:
        [m/rad], 1 for prismatic joints; 0 where a joint does not move a capsule.
    """
    count = model.njoints - 1
    revolute = np.array([joint.shortname().startswith('JointModelR')
                         for joint in list(model.joints)[1:]])
    stroke = np.where(revolute, 0.0, np.maximum(
        np.abs(model.lowerPositionLimit), np.abs(model.upperPositionLimit)))
    length = np.array([float(np.linalg.norm(model.jointPlacements[i + 1].translation))
                       for i in range(count)])
    farthest = np.zeros(count + 1)  # of all that a joint carries, from its origin
    for joint, ends in zip(capsule_joint, capsule_ends):
        farthest[joint] = max(farthest[joint], np.linalg.norm(ends, axis=0).max())
    parents = np.array(list(model.parents)[1:], dtype=np.intp)
    for i in reversed(range(count)):
        beyond = farthest[i + 1] + (length[i] + stroke[i])
        farthest[parents[i]] = max(farthest[parents[i]], beyond)
    bounds = np.where(revolute, farthest[1:], 1.0)
    return bounds * supports_of(capsule_joint, parents)


def pairs_of_payload(
    capsules: Sequence[Capsule], own: int, capsule_joint: Indices, hands: Sequence[int],
    arms: Iterable[Kinematics],
) -> Indices:
    """Return the pairs (p, 2) of what hands hold and links that may hit each other.

    All but the hands count, and but links that it would overlap at most postures.

    Args:
        capsules: the arm's own, then those of what is held.
        own: how many are the arm's own.
        capsule_joint: (c,) the joints that carry them.
        hands: the joints that carry the hands.
        arms: the kinematics at random postures, without end.
    """
    links, held = np.meshgrid(np.arange(own), np.arange(own, len(capsules)), indexing='ij')
    pairs = np.column_stack((links.ravel(), held.ravel()))
    pairs = pairs[~np.isin(capsule_joint[pairs[:, 0]], hands)]
    if not len(pairs):
        return pairs
    radii = np.array([c.radius for c in capsules])
    overlaps = np.array([
        link_distances(arm.segment_start, arm.segment_end, radii, pairs).distance < 0.0
        for arm in islice(arms, _POSTURES_OF_PAYLOAD)])
    return pairs[overlaps.mean(axis=0) <= _LARGEST_OVERLAP_SHARE]


def colliding_pairs(
    capsules: Sequence[Capsule], capsule_joint: Indices, parents: Indices,
    arms: Iterable[Kinematics],
) -> Indices:
    """Return the pairs (p, 2) of capsules that can collide, judged by random postures.

    Three kinds of pairs are left out. Capsules on the same link or on neighbouring links touch
    at their joint. Capsules that overlap at many postures do so by construction. And some that
    are two joints apart never come near each other.

    Args:
        capsules: the link shapes.
        capsule_joint: (c,) the joints that carry them.
        parents: (n,) see `Chain`.
        arms: the kinematics at random postures, without end; taken only if needed.
    """
    pairs = np.column_stack(np.triu_indices(len(capsules), 1))
    if not len(pairs):
        return pairs
    one, other = capsule_joint[pairs].T
    between = joints_between(one, other, parents)
    radii = np.array([c.radius for c in capsules])
    count = _SAMPLED_POSTURES if (between > 1).any() else 0
    sampled = np.array([
        link_distances(arm.segment_start, arm.segment_end, radii, pairs).distance
        for arm in islice(arms, count)]).reshape(-1, len(pairs))
    touching = (sampled < 0.0).sum(axis=0) > _LARGEST_OVERLAP_SHARE * _SAMPLED_POSTURES
    never = (between == 2) & (sampled > _NEVER_NEARER).all(axis=0)
    return pairs[(between > 1) & ~touching & ~never]

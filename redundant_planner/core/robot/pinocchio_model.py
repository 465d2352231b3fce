"""The joints between a base and its tips in a URDF, as Pinocchio's model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.errors import known, RobotError
from redundant_planner.core.robot.urdf import Joint, LARGEST, MOVABLE, Urdf

Array = npt.NDArray[np.float64]

# No arm has more joints: every one of them costs time in every tick.
_MOST_JOINTS = 50


def link_names(model: pin.Model) -> list[str]:
    """Return the names of all links."""
    return [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]


def links_on(model: pin.Model, joint: int) -> tuple[str, ...]:
    """Return the names of the links that a joint carries, 0 for those at rest."""
    return tuple(frame.name for frame in model.frames
                 if frame.type == pin.FrameType.BODY and frame.parentJoint == joint)


def link_id(model: pin.Model, link: str) -> int:
    """Return the frame of a link, which a joint may share its name with, or else any frame."""
    if model.existFrame(link, pin.FrameType.BODY):
        return int(model.getFrameId(link, pin.FrameType.BODY))
    return int(model.getFrameId(link))


def chain_joints(
    urdf: Urdf, base_frame: str, tip_frame: str, locked_positions: Mapping[str, float],
) -> list[Joint]:
    """Return the joints between two links that move, the first of them nearest to the base.

    Raises:
        RobotError: naming the link or joint that makes no chain.
    """
    for role, frame in (('base_frame', base_frame), ('tip_frame', tip_frame)):
        if frame not in urdf.links:
            raise RobotError(f"{role} '{frame}' is not in the URDF; it has {known(urdf.links)}")
    movable = [joint.name for joint in urdf.joints if joint.kind in MOVABLE]
    for name, position in locked_positions.items():
        if name not in movable:
            raise RobotError(f"locked joint '{name}' is not a movable joint of the URDF; "
                             f'it has {known(movable)}')
        if not abs(position) <= LARGEST:
            raise RobotError(f"locked joint '{name}' is held at {position}; "
                             f'it must be a number within ±{LARGEST:g} [rad, m]')

    between = urdf.joints_above(tip_frame)
    if base_frame != urdf.root:
        links = [joint.child for joint in between]
        if base_frame not in links:
            raise RobotError(
                f"tip_frame '{tip_frame}' does not hang from base_frame '{base_frame}'")
        between = between[links.index(base_frame) + 1:]
    ends = f"base_frame '{base_frame}' and tip_frame '{tip_frame}'"
    chain = []
    for joint in between:
        if joint.kind == 'fixed' or joint.name in locked_positions:
            continue
        if joint.kind not in MOVABLE:
            raise RobotError(f"joint '{joint.name}' between {ends} is {joint.kind}; a chain "
                             f'takes {known(MOVABLE)}')
        if joint.mimic is not None:
            raise RobotError(
                f"joint '{joint.name}' between base_frame and tip_frame mimics "
                f"'{joint.mimic.leader}'; a chain takes joints that move on their own")
        chain.append(joint)
    if not chain:
        raise RobotError(f'no movable joint lies between {ends}')
    if len(chain) > _MOST_JOINTS:
        raise RobotError(f'{len(chain)} movable joints lie between {ends}; '
                         f'a chain takes {_MOST_JOINTS} at most')
    return chain


def tree_joints(
    urdf: Urdf, base_frame: str, tips: Sequence[str], locked_positions: Mapping[str, float],
) -> list[Joint]:
    """Return the joints between a base and several tips that move; errors as `chain_joints`."""
    found = {joint.name: joint for tip in tips
             for joint in chain_joints(urdf, base_frame, tip, locked_positions)}
    if len(found) > _MOST_JOINTS:
        raise RobotError(f'{len(found)} movable joints lead to {known(tips)}; the planner takes '
                         f'{_MOST_JOINTS} at most')
    return list(found.values())


def model_of_chain(
    urdf: Urdf, chain: Sequence[Joint], base_frame: str, locked_positions: Mapping[str, float],
) -> pin.Model:
    """Lock every joint outside the chain and make the base frame Pinocchio's world."""
    try:
        model = pin.buildModelFromXML(urdf.for_pinocchio())
    except (ValueError, RuntimeError) as error:
        raise RobotError(f'the URDF does not describe a robot: {error}') from None
    names = tuple(model.names)
    number = {name: i for i, name in enumerate(names)}
    moving = {joint.name for joint in chain}
    posture = np.clip(pin.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)

    def stand(name: str, position: float) -> None:
        posture[model.joints[number[name]].idx_q] = position

    for name, position in locked_positions.items():
        stand(name, position)
    for joint in urdf.joints:
        follows = joint.mimic
        if follows and joint.name not in locked_positions and (
                follows.leader in number and follows.leader not in moving):
            leader = posture[model.joints[number[follows.leader]].idx_q]
            stand(joint.name, follows.multiplier * leader + follows.offset)
    locked = [i for i, name in enumerate(names) if i and name not in moving]
    try:
        reduced = pin.buildReducedModel(model, locked, posture)
    except ValueError as error:
        raise RobotError('a movable joint has the same name as a link, which Pinocchio cannot '
                         f'tell apart; rename one of them: {error}') from None

    data = reduced.createData()
    pin.framesForwardKinematics(reduced, data, pin.neutral(reduced))
    world_in_base = data.oMf[link_id(reduced, base_frame)].inverse()
    for i in range(1, reduced.njoints):
        if reduced.parents[i] == 0:
            reduced.jointPlacements[i] = world_in_base * reduced.jointPlacements[i]
    for frame in reduced.frames:
        if frame.parentJoint == 0:
            frame.placement = world_in_base * frame.placement
    return reduced

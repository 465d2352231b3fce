"""What stays the same from tick to tick, as machine code takes it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, ParameterError
from redundant_planner.core.kernels import IndexPairs, Indices, Matrix, Vector
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.cone import Cone
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.safety.limits import Limits

Array = npt.NDArray[np.float64]


class RobotConstants(NamedTuple):
    """The robot, with its margins and joint weights; what its joints may do is in `Limits`.

    Attributes:
        position_min, position_max: (n,) see `Robot`.
        scaling: (n,) 1 / square root of the joint weights.
        lever_arm_bounds, supports: (c, n) see `Robot`.
        radii, self_pairs, self_supports, self_lever_arm_bounds: the fields of `SelfPairs`; without
            pairs if self-collision is switched off.
        parents: (n,) see `Chain`.
        rows: (m,) the controlled ones of the six axes of each tip.
        in_tool: whether J and twists are in tool axes.
        preferred: (n,) where the joints should rather be; NaN for anywhere [rad, m].
        cone: that an axis of the tip stays in.
    """

    position_min: Vector
    position_max: Vector
    scaling: Vector
    lever_arm_bounds: Matrix
    supports: Matrix
    radii: Vector
    self_pairs: IndexPairs
    self_supports: Matrix
    self_lever_arm_bounds: Matrix
    parents: Indices
    rows: Indices
    in_tool: bool
    preferred: Vector
    cone: Cone


class Gains(NamedTuple):
    """The parameters that a tick takes, see `PlannerParameters`.

    Attributes:
        fixed: whether k is k_fixed instead of Eq. 2's.
    """

    criteria_k_w: float
    criteria_k_s: float
    criteria_k_f: float
    criteria_k_m: float
    criteria_k_alpha: float
    criteria_k_fixed: float
    clearance_smoothing: float
    clearance_influence_distance: float
    clearance_lead: float
    clearance_evasion_horizon: float
    clearance_gain: float
    horizon_look_ahead: float
    singularity_margin: float
    singularity_damping_threshold: float
    singularity_damping: float
    posture_weight: float
    feedback_gain: float
    feedback_speed: float
    feedback_angular_speed: float
    feedback_distance: float
    feedback_angle: float
    fixed: bool


def joint_weights(robot: Robot, parameters: PlannerParameters) -> Array:
    """Return the weight of every joint's motion, (n,).

    Raises:
        ParameterError: there are not as many as joints.
    """
    weights = np.array(parameters.criteria_joint_weights or robot.weights)
    if weights.shape != (robot.n,):
        raise ParameterError(
            f"parameter 'criteria.joint_weights' has {weights.size} entries; it takes {robot.n}, "
            f"one per joint of '{robot.name}', or none")
    return weights


def limits_of(robot: Robot, parameters: PlannerParameters) -> Limits:
    """Return what the joints may do, with the margin of their positions.

    Raises:
        ParameterError: the margin leaves a joint no range.
    """
    margin = parameters.limits_position_margin
    narrow = robot.position_max - robot.position_min <= 2.0 * margin
    if narrow.any():
        name = robot.joint_names[int(narrow.argmax())]
        raise ParameterError(f"parameter 'limits.position_margin' is {margin}; joint '{name}' has "
                             'no range left between its limits')
    return Limits(np.array((robot.position_max - margin, robot.position_min + margin)),
                  np.array(robot.velocity_max), np.array(robot.acceleration_max), margin)


def robot_constants(robot: Robot, parameters: PlannerParameters) -> RobotConstants:
    """Return the robot as a tick takes it.

    Raises:
        ParameterError: posture.preferred does not fit the robot.
    """
    self_margin = parameters.clearance_self_margin
    # Only the joints between two links bring these nearer to each other.
    pairs = robot.self_pairs if self_margin > -1.0 else robot.self_pairs[:0]
    supports = robot.supports[pairs[:, 0]] - robot.supports[pairs[:, 1]]
    radii = np.array([capsule.radius for capsule in robot.capsules])
    return RobotConstants(
        np.array(robot.position_min), np.array(robot.position_max),
        1.0 / np.sqrt(joint_weights(robot, parameters)), np.array(robot.lever_arm_bounds),
        np.array(robot.supports), radii + self_margin / 2.0, np.array(pairs), supports,
        np.abs(supports) * robot.lever_arm_bounds[pairs].max(axis=1),
        np.array(robot.chain.parents), np.array(robot.rows), robot.in_tool,
        preferred_posture(robot, parameters), _cone(parameters))


def preferred_posture(robot: Robot, parameters: PlannerParameters) -> Array:
    """Return where the joints should rather be (n,), NaN for anywhere [rad, m].

    Raises:
        ParameterError: a joint is unknown, or cannot be there.
    """
    preferred = np.full(robot.n, np.nan)
    for entry in parameters.posture_preferred:
        name, _, position = entry.partition('=')
        if name not in robot.joint_names:
            raise ParameterError(f"parameter 'posture.preferred' names joint '{name}'; "
                                 f"'{robot.name}' has {known(robot.joint_names)}")
        j, wanted = robot.joint_names.index(name), float(position)
        if not robot.position_min[j] <= wanted <= robot.position_max[j]:
            raise ParameterError(
                f"parameter 'posture.preferred' has '{entry}'; joint '{name}' goes from "
                f'{robot.position_min[j]:g} to {robot.position_max[j]:g}')
        preferred[j] = wanted
    return preferred


def _cone(parameters: PlannerParameters) -> Cone:
    axis, direction = np.array(parameters.cone_tip_axis), np.array(parameters.cone_direction)
    return Cone(axis / np.linalg.norm(axis), direction / np.linalg.norm(direction),
                parameters.cone_angle)


def gains_of(parameters: PlannerParameters) -> Gains:
    """Return the parameters as a tick takes them."""
    numbers = {name: float(getattr(parameters, name)) for name in Gains._fields[:-1]}
    return Gains(**numbers, fixed=parameters.method == 'gradient_projection')

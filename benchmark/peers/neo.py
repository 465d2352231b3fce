"""NEO's QP (Haviland and Corke 2021), written from the paper, with DAQP and coal's distances.

roboticstoolbox-python has its parts, but not for an arm of capsules: its link dampers take the
shapes of its own models. Gains and distances are those of its example. The QP has the joint
velocities and a slack for each axis: it weighs speed by λ and the slack by the inverse of the
error, and goes uphill in manipulability. Obstacles and joint limits are velocity dampers. NEO has
no dampers between links, and no acceleration limits.
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import daqp
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from benchmark.bodies import capsules_of, shape_of
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, pose_error

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_SPEED_WEIGHT = 0.01  # λ
_SLACK = 10.0  # the most [m/s, rad/s]
# Of the dampers: distance of influence [m] and gain [1/s]; angles of influence and of rest [rad].
_INFLUENCE, _GAIN = 0.3, 1.0
_INFLUENCE_ANGLE, _REST_ANGLE = 0.9, 0.05
_LEAST_ERROR = 1e-6
_SOLVED = 1
_UNBOUNDED = 1e30


class Neo:
    """NEO's controller; see the module."""

    def __init__(
        self, robot: Robot, obstacles: Sequence[Obstacle], margin: float, self_margin: float,
    ) -> None:
        """Take arm and obstacles; the margin to obstacles in [m], that between links is unused."""
        self._robot, self._margin = robot, margin
        self._bodies = capsules_of(robot)
        self._data = self._bodies.model.createData()
        self._shapes = [shape_of(obstacle) for obstacle in obstacles]
        self.move(obstacles)

    def step(self, q: Array, target: Pose, dt: float) -> Array:
        """See `Peer`."""
        robot, arm = self._robot, self._robot.kinematics(q)
        n, m = robot.n, robot.m
        wanted = robot.task_rows(pose_error(
            target, Pose(arm.tip_position, arm.tip_rotation), robot.in_tool))
        weights = np.full(n + m, _SPEED_WEIGHT)
        weights[n:] = 1.0 / max(float(np.abs(wanted).sum()), _LEAST_ERROR)
        linear = np.zeros(n + m)
        linear[:n] = -manipulability_gradient(arm.tip_jacobian, robot.rows)
        rows, most = self._dampers(q)
        upper = np.concatenate((robot.velocity_max, np.full(m, _SLACK)))
        lower = -upper
        self._damp_limits(q, lower[:n], upper[:n])
        wanted = wanted / dt
        solved, _, status, _ = daqp.solve(
            np.diag(weights), linear,
            np.vstack((np.hstack((arm.jacobian, np.eye(m))),
                       np.hstack((rows, np.zeros((len(rows), m)))))),
            np.concatenate((upper, wanted, most)),
            np.concatenate((lower, wanted, np.full(len(rows), -_UNBOUNDED))),
            np.concatenate((np.zeros(n + m), np.full(m, 5), np.zeros(len(rows)))).astype(np.int32))
        return np.array(solved[:n]) if status == _SOLVED else np.zeros(n)

    def move(self, obstacles: Sequence[Obstacle]) -> None:
        """See `Peer`."""
        self._places = [coal.Transform3s(np.array(o.rotation), np.array(o.center))
                        for o in obstacles]
        self._velocities = [np.array(o.velocity) for o in obstacles]

    def _damp_limits(self, q: Array, lower: Array, upper: Array) -> None:
        """Narrow the bounds (n,) near the joints' ends, in place."""
        robot = self._robot
        for left, bound in ((robot.position_max - q, upper), (q - robot.position_min, lower)):
            near = left < _INFLUENCE_ANGLE
            allowed = _GAIN * (left[near] - _REST_ANGLE) / (_INFLUENCE_ANGLE - _REST_ANGLE)
            if bound is upper:
                bound[near] = np.minimum(bound[near], allowed)
            else:
                bound[near] = np.maximum(bound[near], -allowed)
        # Beyond the angle of rest a joint has to come back; both bounds stay in order.
        np.minimum(lower, upper, out=lower)

    def _dampers(self, q: Array) -> tuple[Array, Array]:
        """Return rows (k, n) and the most (k,) that they may come to: approach to obstacles."""
        model, data, bodies = self._bodies.model, self._data, self._bodies
        pin.computeJointJacobians(model, data, q)
        rows, most = [], []
        request = coal.DistanceRequest(True)
        for joint, placement, shape in zip(bodies.joints, bodies.placements, bodies.shapes):
            if joint == 0:
                continue
            at = data.oMi[joint] * placement
            place = coal.Transform3s(at.rotation, at.translation)
            jacobian = None
            for other, there, velocity in zip(self._shapes, self._places, self._velocities):
                result = coal.DistanceResult()
                distance = coal.distance(shape, place, other, there, request, result)
                if distance > _INFLUENCE:
                    continue
                # Unit vector from the link to the obstacle, also where they overlap.
                direction, point = np.array(result.normal), np.array(result.getNearestPoint1())
                if jacobian is None:
                    jacobian = pin.getJointJacobian(
                        model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
                lever = np.cross(point - data.oMi[joint].translation, direction)
                rows.append(direction @ jacobian[:3] + lever @ jacobian[3:])
                most.append(_GAIN * (distance - self._margin) / (_INFLUENCE - self._margin)
                            + direction @ velocity)
        return np.array(rows).reshape(-1, self._robot.n), np.array(most)


def manipulability_gradient(jacobian: Array, rows: Indices) -> Array:
    """Return the gradient (n,) of √det(JJᵀ) from a tip's Jacobian (6, n) in the base frame.

    ∂m/∂q_k = m · trace(J⁺ ∂J/∂q_k), with the Hessian of Haviland and Corke (2021).

    Args:
        jacobian: of the tip, linear velocities first.
        rows: (m,) the axes that count.
    """
    linear, angular = jacobian[:3].T, jacobian[3:].T
    n = len(linear)
    hessian = np.zeros((n, 6, n))  # by joint k, axis, column
    for k in range(n):
        hessian[k, :3, k:] = np.cross(angular[k], linear[k:]).T
        hessian[k, :3, :k] = np.cross(angular[:k], linear[k]).T
        hessian[k, 3:, k:] = np.cross(angular[k], angular[k:]).T
    kept = jacobian[rows]
    size = float(np.prod(np.linalg.svd(kept, compute_uv=False)))
    return size * np.einsum('jr,krj->k', np.linalg.pinv(kept), hessian[:, rows])

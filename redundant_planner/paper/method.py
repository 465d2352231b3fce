"""The paper's method to the letter: Eqs. 1, 2, 3, 7 and 18, nothing else.

No joint limits, no safety filter, no damping, no feedback, no smoothing; Eq. 7 over the joints
alone. The arm runs into limits and obstacles: this is for simulations and comparisons. The one
departure is H_f, whose printed Eq. 17 has no effect (docs/paper.md): here it is ½‖J⁺ẋ‖² with
its exact gradient.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, ParameterError, StateError
from redundant_planner.core.horizon.preview import TwistAhead
from redundant_planner.core.obstacles.clearance import link_clearance, pseudo_distance
from redundant_planner.core.obstacles.clearance_gradients import clearance_gradients
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PAPER_METHODS, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.redundancy.criteria import joint_limit_index
from redundant_planner.core.redundancy.null_space import dynamic_factor
from redundant_planner.core.robot.jacobian import derivative_times
from redundant_planner.core.robot.kinematics import Kinematics, Links
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import integrate, Pose, pose_error, Poses
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.step_result import Nearest, StepResult
from redundant_planner.core.target.goal import Target, TipTargets
from redundant_planner.core.target.moving_target import Sighting

Array = npt.NDArray[np.float64]


class PaperPlanner:
    """The paper's method for one robot, with the calls of `Planner`.

    Of the parameters it takes `method` ('paper' for Eq. 2's factor, 'paper_gradient_projection'
    for a fixed one), criteria.k_alpha, k_fixed, k_w, k_s and k_f. It also slows a command to
    limits.linear_speed and limits.angular_speed. The others do not act.
    """

    def __init__(self, robot: Robot, parameters: PlannerParameters) -> None:
        """Prepare for a robot.

        Raises:
            ParameterError: it is not the paper's method that is asked for, joints are weighted, or
                the robot has several tips.
        """
        if len(robot.tips) > 1:
            raise ParameterError(f"parameter 'method' is '{parameters.method}', which takes one "
                                 f"tip; '{robot.name}' has {known(robot.tips)}")
        self.robot = robot
        self.reference: Pose | None = None
        self.parameters = parameters

    @property
    def parameters(self) -> PlannerParameters:
        """The parameters in use; assigning replaces them all, from the next tick on."""
        return self._parameters

    @parameters.setter
    def parameters(self, parameters: PlannerParameters) -> None:
        if parameters.method not in PAPER_METHODS:
            raise ParameterError(
                f"parameter 'method' is '{parameters.method}'; a planner that began with one of "
                f'{known(PAPER_METHODS)} keeps to these')
        if parameters.criteria_joint_weights:
            raise ParameterError("parameter 'criteria.joint_weights' is set; the paper's method "
                                 'has no joint weights')
        self._parameters = parameters

    @property
    def references(self) -> Poses | None:
        """Where the tip should be now; None before the first tick after a reset."""
        return None if self.reference is None else Poses.of(self.reference)

    def reset(self) -> None:
        """Forget the reference pose: the arm stands where it is found."""
        self.reference = None
        self._followed, self._dt = np.zeros(6), 0.0

    def hold(self, things: Iterable[Obstacle]) -> None:
        """Have `Nearest` tell of what the hand holds, too; Eq. 7 minds the joints alone."""
        self.robot = self.robot.holding(things)

    def braked(self, dq: Array, dt: float) -> None:
        """Leave the path that was followed: something else was commanded, to stop the arm."""
        self.reset()

    def missed(self, ticks: int) -> None:
        """Note that ticks did not take place, and the tip went on as in the last one."""
        if self.reference is not None:
            self.reference = integrate(
                self.reference, self._followed, ticks * self._dt, self.robot.in_tool)

    def prepare(self, scene: Scene) -> bool:
        """Do nothing: a new scene costs nothing ahead."""
        return False

    def step(
        self, q: Array, twist: Array, scene: Scene, dt: float, ahead: TwistAhead | None = None,
        target: Target | TipTargets | None = None, *, news: Sequence[Sighting] = (),
        gently: bool = False, carefully: bool = False,
    ) -> StepResult:
        """Return the joint velocity for the next `dt`: q̇ = J⁺ẋ + k P∇H (Eq. 1).

        Args:
            q, twist, scene, dt: as for `Planner.step`.
            ahead: not looked at.
            target: the paper has none; must be None.
            news, gently, carefully: not looked at.

        Raises:
            StateError: as for `Planner.step`.
        """
        p, robot = self._parameters, self.robot
        command = self._command(twist, dt)
        arm = robot.kinematics(q)
        x_dot, jacobian = robot.task_rows(command), arm.jacobian
        pseudo_inverse = np.linalg.pinv(jacobian)
        least_norm = pseudo_inverse @ x_dot
        null_space_projector = np.eye(robot.n) - pseudo_inverse @ jacobian

        # Eq. 18, with the indices' signs: H_w is maximised, H_s and H_f are minimised.
        clearance, clearance_gradient = self._clearance_index(arm, scene)
        _, joint_limit_gradient = joint_limit_index(
            arm.q, robot.position_min, robot.position_max)
        gradient = (p.criteria_k_w * clearance_gradient - p.criteria_k_s * joint_limit_gradient
                    - p.criteria_k_f * self._shortest_path_gradient(arm, x_dot, least_norm))
        projected = null_space_projector @ gradient

        factor = p.criteria_k_fixed if p.method == 'paper_gradient_projection' else (
            dynamic_factor(p.criteria_k_alpha, least_norm, projected))  # Eq. 2
        homogeneous = factor * projected
        dq = least_norm + homogeneous  # Eq. 1

        pose = Pose(arm.tip_position, arm.tip_rotation)
        reference = self.reference or pose
        error = robot.full_twist(pose_error(reference, pose, robot.in_tool)[robot.rows])
        self._followed, self._dt = robot.full_twist(jacobian @ dq), dt
        self.reference = integrate(reference, self._followed, dt, robot.in_tool)
        return StepResult(
            dq, least_norm, homogeneous, factor, 1.0, Stage.DESIRED, '', '', clearance,
            self._nearest(arm, scene), math.sqrt(max(np.linalg.det(jacobian @ jacobian.T), 0.0)),
            pose, error)

    def _command(self, twist: Array, dt: float) -> Array:
        """Return the twist, no faster than the speed limits of a command."""
        command = np.array(twist, dtype=float)
        if command.shape != (6,) or not np.isfinite(command).all():
            raise StateError(f'twist is {command.tolist()}; it takes six finite numbers '
                             '[m/s, rad/s]')
        if not (math.isfinite(dt) and dt > 0.0):
            raise StateError(f'dt is {dt}; it must be positive [s]')
        command = self.robot.full_twist(self.robot.task_rows(command))
        excess = max(1.0, *(
            float(np.linalg.norm(part)) / max(limit, 1e-12)
            for part, limit in zip((command[:3], command[3:]), self._parameters.twist_speeds)))
        return command / excess

    def _clearance_index(self, arm: Kinematics, scene: Scene) -> tuple[float, Array]:
        """Return H_w of Eq. 7 over the joints, and its gradient: that of the smallest S."""
        n = self.robot.n
        points = self.robot.joint_points(arm.q)
        points_only = inflated_obstacles(scene, np.zeros(len(points)))
        pairs = link_clearance(points_only, points, points)
        rho = pairs.normalized_distance
        if not rho.size:
            return math.inf, np.zeros(n)
        at = np.unravel_index(int(rho.argmin()), rho.shape)
        smallest = float(rho[at])
        gradient, _ = clearance_gradients(
            points_only, pairs, (np.array([at[0]]), np.array([at[1]])),
            Links(points, points, arm.joint_screws, np.tril(np.ones((len(points), n))),
                  self.robot.chain.parents))
        return pseudo_distance(smallest), 2.0 * (smallest + 1.0) * gradient[0]  # ∂S/∂ρ = 2 (ρ + 1)

    def _shortest_path_gradient(self, arm: Kinematics, x_dot: Array, least_norm: Array) -> Array:
        """Return the gradient (n,) of H_f = ½‖J⁺ẋ‖²: −yᵀ (∂J/∂q_k) J⁺ẋ with y = (JJᵀ)⁻¹ẋ."""
        y = np.linalg.pinv(arm.jacobian @ arm.jacobian.T) @ x_dot
        return -y @ derivative_times(
            arm.tip_jacobian, least_norm, arm.tip_rotations, self.robot.in_tool, self.robot.rows)

    def _nearest(self, arm: Kinematics, scene: Scene) -> Nearest | None:
        """Return the nearest pair of whole links and obstacles, without any margin."""
        capsules = self.robot.capsules
        maps = inflated_obstacles(scene, [c.radius for c in capsules], moved=self.robot.moved)
        pairs = link_clearance(maps, arm.segment_start, arm.segment_end)
        if not pairs.distance.size:
            return None
        link, obstacle = np.unravel_index(int(pairs.distance.argmin()), pairs.distance.shape)
        return Nearest(
            capsules[link].name, scene.names[obstacle],
            pseudo_distance(float(pairs.normalized_distance[link, obstacle])),
            float(pairs.distance[link, obstacle]))


def planner_of(robot: Robot, parameters: PlannerParameters) -> Planner | PaperPlanner:
    """Return the planner for the method that parameters name.

    Raises:
        ParameterError: the parameters do not fit this robot.
    """
    kind = PaperPlanner if parameters.method in PAPER_METHODS else Planner
    return kind(robot, parameters)

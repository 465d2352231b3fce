"""One tick of the planner: state, command and scene in, joint velocity out.

The only composition in the package. Every line of `Planner.step` is an equation of the paper or
a section of docs/derivations.md and docs/safety.md.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core import drift, indices, jacobian, null_space, safety
from redundant_planner.core.drift import Pose
from redundant_planner.core.errors import ParameterError, StateError
from redundant_planner.core.obstacles import (
    clearance_gradients,
    link_clearance,
    Pairs,
    pseudo_distance,
    Scene,
    Whitening,
    whitening,
)
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot import Kinematics, Robot
from redundant_planner.core.self_collision import distance_gradients, link_distances

Array = npt.NDArray[np.float64]

# An arm that is not commanded and this close to where it should be is left in peace [m, rad].
_AT_REST = 1e-5
# The singularity barrier is looked at below this multiple of its margin.
_SINGULARITY_NEAR = 5.0
_NO_PAIRS = np.empty(0, dtype=np.intp)


class Nearest(NamedTuple):
    """The link and obstacle with the smallest level value.

    Attributes:
        link, obstacle: their names.
        level: S of Eq. 6 over the whole link, 0 at the safety margin.
        distance: [m] not more than the true distance beyond the margin; negative inside.
    """

    link: str
    obstacle: str
    level: float
    distance: float


class _Near(NamedTuple):
    """The pairs of links and obstacles that could act in a tick.

    Attributes:
        links, obstacles: (p,) indices.
        clearance: (p,) ρ.
        gradient: (p, n) ∂ρ/∂q.
        rate: (p,) ∂ρ/∂t from the obstacles' own motion [1/s].
    """

    links: npt.NDArray[np.intp]
    obstacles: npt.NDArray[np.intp]
    clearance: Array
    gradient: Array
    rate: Array


class StepResult(NamedTuple):
    """What one tick decided; arrays are the caller's to keep.

    Attributes:
        dq: (n,) joint velocity command [rad/s, m/s].
        least_norm: (n,) J⁺ẋ of this tick.
        homogeneous: (n,) k P∇H of this tick.
        factor: k of Eq. 1.
        scale: s, the share of the commanded twist that is followed.
        stage: how the safety filter came to `dq`.
        reason: one sentence: what slows or stops the arm; empty when nothing does.
        clearance_index: H_w; infinite without obstacles.
        nearest: the nearest pair, None without obstacles.
        manipulability: Yoshikawa's measure, the product of J's singular values.
        pose: the tip at the measured posture.
        path_error: (6,) reference pose minus `pose` before this tick, in command axes [m, rad].
    """

    dq: Array
    least_norm: Array
    homogeneous: Array
    factor: float
    scale: float
    stage: safety.Stage
    reason: str
    clearance_index: float
    nearest: Nearest | None
    manipulability: float
    pose: Pose
    path_error: Array


class Planner:
    """Velocity-level redundancy resolution for one robot.

    Between ticks it remembers the last joint velocity, the reference pose and when the links
    were last measured against each other, nothing else: the same sequence of inputs gives the
    same sequence of outputs.
    """

    def __init__(self, robot: Robot, parameters: PlannerParameters) -> None:
        """Prepare for a robot.

        Raises:
            ParameterError: the parameters do not fit this robot.
        """
        self.robot = robot
        self._maps_of: tuple[Scene, Whitening] | None = None
        self._radii = np.array([c.radius for c in robot.capsules])
        count = robot.capsule_joint_count[robot.self_pairs]
        joints = np.arange(robot.n)
        self._self_levers = robot.levers * (
            (joints >= count.min(axis=0)[:, None]) & (joints < count.max(axis=0)[:, None]))
        self._points = np.arange(1, robot.n + 2).clip(max=robot.n)
        self._controlled = robot.full_twist(np.ones(robot.m)) > 0.0
        self.parameters = parameters
        self.reset()

    @property
    def parameters(self) -> PlannerParameters:
        """The parameters in use; assigning replaces them all, from the next tick on."""
        return self._parameters

    @parameters.setter
    def parameters(self, parameters: PlannerParameters) -> None:
        robot = self.robot
        weights = np.array(parameters.joint_weights or np.ones(robot.n))
        if weights.shape != (robot.n,):
            raise ParameterError(
                f"parameter 'joint_weights' has {weights.size} entries; it takes {robot.n}, one "
                f"per joint of '{robot.name}', or none")
        margin = parameters.position_margin
        narrow = robot.position_max - robot.position_min <= 2.0 * margin
        if narrow.any():
            name = robot.joint_names[int(narrow.argmax())]
            raise ParameterError(f"parameter 'position_margin' is {margin}; joint '{name}' has "
                                 'no range left between its limits')
        self._parameters = parameters
        self._self_known: tuple[Array, Array] | None = None
        self._weights = weights
        self._scaling = 1.0 / np.sqrt(weights)
        self._limits = safety.Limits(robot.position_min + margin, robot.position_max - margin,
                                     robot.velocity_max, robot.acceleration_max)
        self._maps_of = None

    def reset(self) -> None:
        """Forget the last velocity and the reference pose: the arm stands where it is found."""
        self._previous = np.zeros(self.robot.n)
        self._followed: Array = np.zeros(self.robot.m)
        self._reference: Pose | None = None
        self._self_known = None

    @property
    def reference(self) -> Pose | None:
        """Where the tip should be now; None before the first tick after a reset."""
        return self._reference

    def step(self, q: Array, twist: Array, scene: Scene, dt: float) -> StepResult:
        """Return the joint velocity for the next `dt`.

        Args:
            q: (n,) measured joint positions [rad, m].
            twist: (6,) commanded tip twist in the command frame [m/s, rad/s]; entries of axes
                that are not controlled do not count.
            scene: the obstacles. Pass the same object while nothing changes.
            dt: time until the next tick [s].

        Raises:
            StateError: `q` or `twist` does not fit the robot, or `dt` is not positive.
        """
        robot, p = self.robot, self._parameters
        command = self._checked_command(twist, dt)
        arm = robot.kinematics(q)

        # ẋ: the command plus what brings the tip back to the reference pose (§ drift).
        pose = Pose(arm.tip_position, arm.tip_rotation)
        error = self._path_error(pose)
        correction = drift.feedback(error, p.drift_gain, p.drift_speed, p.drift_angular_speed)
        if not command.any() and float(np.abs(error).max()) < _AT_REST:
            correction = np.zeros(6)
        task = robot.task_rows(command + correction)

        # J⁺ẋ, in coordinates in which every joint costs the same.
        parts = null_space.decompose(arm.jacobian * self._scaling)
        gains = null_space.inverse_gains(
            parts.singular_values, p.damping_threshold, p.damping)
        least_norm = null_space.least_norm(parts, gains, task)

        # ∇H, Eq. 18, and k P∇H, Eqs. 1 and 2.
        maps, pairs = self._clearances(arm, scene)
        level, slopes = self._clearance_index(maps, pairs)
        near = self._near(arm, maps, pairs, slopes, dt)
        if p.clearance_points == 'joints':
            level, clearance = self._clearance_of_joints(arm, scene)
        else:
            clearance = slopes[near.links, near.obstacles] @ near.gradient
        gradient = self._total_gradient(arm, clearance, parts, gains, least_norm, task)
        projected = null_space.project(parts, gradient * self._scaling)
        factor = p.k_fixed
        if p.method == 'dynamic_factor':
            factor = null_space.dynamic_factor(
                p.k_alpha, _size(least_norm), _size(projected))
        least_norm = self._scaling * least_norm
        homogeneous = self._scaling * (factor * projected)
        dq = least_norm + homogeneous  # Eq. 1

        scale, stage, reason, coasting = 1.0, safety.Stage.DESIRED, '', self._followed
        self._followed = arm.jacobian @ dq - robot.task_rows(correction)
        if p.safety_filter:
            result, reason = self._filtered(
                dq, parts, arm, task, near, scene, bool(command.any()), dt)
            dq, scale, stage = result.dq, result.scale, result.stage
            # What was followed of the path; neither the way back to it nor what was yielded.
            self._followed = scale * robot.task_rows(command) + result.coast * coasting

        self._reference = drift.integrate(
            drift.displaced(pose, error, robot.command_frame),
            robot.full_twist(self._followed), dt, robot.command_frame)
        self._previous = dq
        return StepResult(
            dq.copy(), least_norm, homogeneous, factor, scale, stage, reason, level,
            self._nearest(maps, pairs, scene), parts.manipulability, pose, error)

    def _checked_command(self, twist: Array, dt: float) -> Array:
        """Return the controlled part of the twist, no faster than the speed limits."""
        command = np.array(twist, dtype=float)
        if command.shape != (6,) or not np.isfinite(command).all():
            raise StateError(f'twist is {command.tolist()}; it takes six finite numbers '
                             '[m/s, rad/s]')
        if not (np.isfinite(dt) and dt > 0.0):
            raise StateError(f'dt is {dt}; it must be positive [s]')
        command[~self._controlled] = 0.0
        excess = max(float(np.abs(command[:3]).max()) / self._parameters.linear_speed_max,
                     float(np.abs(command[3:]).max()) / self._parameters.angular_speed_max)
        if excess > 1.0:
            # Through the largest entry first: the norm of an absurd twist would overflow.
            command /= excess
        linear = _size(command[:3]) / self._parameters.linear_speed_max
        angular = _size(command[3:]) / self._parameters.angular_speed_max
        return command / max(linear, angular, 1.0)

    def _path_error(self, pose: Pose) -> Array:
        """Return the error against the reference, nothing on axes that are not controlled."""
        if self._reference is None:
            return np.zeros(6)
        error = drift.pose_error(self._reference, pose, self.robot.command_frame)
        error[~self._controlled] = 0.0
        return drift.bounded(
            error, self._parameters.drift_distance, self._parameters.drift_angle)

    def _clearances(self, arm: Kinematics, scene: Scene) -> tuple[Whitening, Pairs]:
        """Return every link × every obstacle; links carry the clearance margin."""
        if self._maps_of is None or self._maps_of[0] is not scene:
            self._maps_of = scene, whitening(
                scene, self._radii + self._parameters.clearance_margin)
        maps = self._maps_of[1]
        return maps, link_clearance(maps, arm.segment_start, arm.segment_end)

    def _clearance_index(self, maps: Whitening, pairs: Pairs) -> tuple[float, Array]:
        """Return H_w of Eq. 7 and its slopes in every pair's ρ."""
        p = self._parameters
        if p.k_w == 0.0 or p.clearance_points == 'joints':
            return np.inf, np.zeros(pairs.clearance.shape)
        return indices.clearance_index(maps, pairs, smoothing=p.clearance_smoothing,
                                       influence_distance=p.influence_distance)

    def _clearance_of_joints(self, arm: Kinematics, scene: Scene) -> tuple[float, Array]:
        """Return H_w and ∇H_w over the joints alone, as the paper takes them."""
        p, points = self._parameters, arm.joint_points
        maps = whitening(scene, np.zeros(len(points)))
        pairs = link_clearance(maps, points, points)
        level, slopes = indices.clearance_index(
            maps, pairs, smoothing=p.clearance_smoothing, influence_distance=p.influence_distance)
        links, obstacles = np.nonzero(slopes)
        gradient, _ = clearance_gradients(
            maps, pairs, links, obstacles, points, points, arm.columns, self._points)
        return level, slopes[links, obstacles] @ gradient

    def _near(
        self, arm: Kinematics, maps: Whitening, pairs: Pairs, slopes: Array, dt: float,
    ) -> _Near:
        """Return the pairs that could act in this tick, all of them, and their gradients.

        Those are the pairs that count in H_w, and those whose barrier could act: no point of a
        link moves faster than Σ |q̇_j| lever_j, and ρ falls by at most that times
        1 / (smallest semi-axis).
        """
        chosen = slopes > 0.0
        if self._parameters.safety_filter:
            rate, fastest = self._reach(dt)
            speed = float(fastest @ self.robot.levers)
            chosen |= rate * pairs.clearance <= (speed + maps.speeds) * maps.steepest
        links, obstacles = np.nonzero(chosen)
        gradient, drift_rate = clearance_gradients(
            maps, pairs, links, obstacles, arm.segment_start, arm.segment_end, arm.columns,
            self.robot.capsule_joint_count)
        return _Near(links, obstacles, pairs.clearance[links, obstacles], gradient, drift_rate)

    def _total_gradient(
        self, arm: Kinematics, clearance: Array, parts: null_space.Decomposition, gains: Array,
        least_norm: Array, task: Array,
    ) -> Array:
        """Return ∇H of Eq. 18; an index of no weight costs nothing."""
        p, robot = self._parameters, self.robot
        joint_limit: Array = np.zeros(robot.n)
        shortest_path: Array = np.zeros(robot.n)
        if p.k_s > 0.0:
            _, joint_limit = indices.joint_limit_index(
                arm.q, robot.position_min, robot.position_max)
        if p.k_f > 0.0:
            dual = parts.left @ (gains * gains * (parts.left.T @ task))
            _, shortest_path = indices.shortest_path_index(
                least_norm, dual, self._jacobian_derivative(arm, self._scaling * least_norm))
        return indices.total_gradient(
            clearance, joint_limit, shortest_path, k_w=p.k_w, k_s=p.k_s, k_f=p.k_f)

    def _jacobian_derivative(self, arm: Kinematics, dq: Array) -> Array:
        """Return the columns (∂J/∂q_k) q̇ of the controlled axes, (m, n)."""
        if self.robot.command_frame == 'tool':
            columns = jacobian.tool_derivative_times(arm.tip_jacobian, arm.tip_rotation, dq)
        else:
            columns = jacobian.jacobian_derivative_times(arm.tip_jacobian, dq)
        return columns[self._controlled]

    def _filtered(
        self, desired: Array, parts: null_space.Decomposition, arm: Kinematics, task: Array,
        near: _Near, scene: Scene, commanded: bool, dt: float,
    ) -> tuple[safety.Filtered, str]:
        """Pass the desired velocity through the safety filter and name what acted."""
        may_yield = self._parameters.path_priority == 'yield' and bool(
            ((near.clearance < 0.0) | (near.rate < 0.0)).any())
        own, own_gradient, distance = self._self_clearances(arm, dt)
        barriers = safety.Barriers(near.gradient, near.rate, near.clearance)
        if len(own):
            barriers = safety.Barriers(
                np.concatenate((near.gradient, own_gradient)),
                np.append(near.rate, np.zeros(len(own))), np.append(near.clearance, distance))
        exact = bool(parts.singular_values[-1] >= self._parameters.damping_threshold)
        result = safety.safe_velocity(
            desired, exact, arm.jacobian, task, arm.q, self._previous, self._limits, barriers,
            weights=self._weights, gain=self._parameters.barrier_gain,
            may_yield=may_yield, dt=dt, singularity=self._singularity(arm, parts))
        return result, self._reason(
            result, commanded, lambda: self._pair_names(near, own, scene), dt)

    def _singularity(
        self, arm: Kinematics, parts: null_space.Decomposition,
    ) -> safety.SingularityBarrier | None:
        """Return the barrier of the smallest singular value σ, None where it is far away.

        With its directions u and v, ∂σ/∂q_k = uᵀ (∂J/∂q_k) v.
        """
        margin, smallest = self._parameters.singularity_margin, parts.singular_values[-1]
        if smallest > _SINGULARITY_NEAR * margin:
            return None
        columns = self._jacobian_derivative(arm, self._scaling * parts.right[-1])
        return safety.SingularityBarrier(parts.left[:, -1] @ columns, float(smallest - margin))

    def _self_clearances(
        self, arm: Kinematics, dt: float,
    ) -> tuple[npt.NDArray[np.intp], Array, Array]:
        """Return the pairs of links that may meet in this tick, their gradients and distances.

        Links found closer than the margin may stay so, they only may not get closer: capsules
        are fatter than links, and an arm must not start to move by itself because of it.
        """
        robot, margin = self.robot, self._parameters.self_collision_margin
        first, second = robot.self_pairs
        if margin <= -1.0 or not len(first):
            return _NO_PAIRS, np.empty((0, robot.n)), np.empty(0)
        rate, fastest = self._reach(dt)
        # A pair's distance falls by no more than the joints between its links have moved: as
        # long as that settles it, nothing needs to be measured.
        reach = (self._self_levers @ fastest) / rate
        if self._self_known is not None:
            known_at, known = self._self_known
            if (known - self._self_levers @ np.abs(arm.q - known_at) > reach).all():
                return _NO_PAIRS, np.empty((0, robot.n)), np.empty(0)
        pairs = link_distances(
            arm.segment_start, arm.segment_end, self._radii + margin / 2.0, first, second)
        self._self_known = arm.q, pairs.distance
        near = np.flatnonzero(pairs.distance <= reach)
        gradient = distance_gradients(
            pairs, near, first, second, arm.columns, robot.capsule_joint_count)
        return near, gradient, np.maximum(pairs.distance[near], 0.0)

    def _pair_names(
        self, near: _Near, own: npt.NDArray[np.intp], scene: Scene,
    ) -> list[str]:
        """Name the barriers in their order, as sentences' parts."""
        names = [capsule.name for capsule in self.robot.capsules]
        found = [f"link '{names[link]}' near obstacle '{scene.names[obstacle]}'"
                 for link, obstacle in zip(near.links, near.obstacles)]
        found += [f"link '{names[i]}' near link '{names[j]}'"
                  for i, j in self.robot.self_pairs[:, own].T]
        return [*found, 'near a singularity']

    def _reason(
        self, result: safety.Filtered, commanded: bool, pair_names: Callable[[], list[str]],
        dt: float,
    ) -> str:
        """Say what holds the arm back; the drives' own way to speed up and stop does not count."""
        harmless = (safety.Stage.DESIRED, safety.Stage.SCALED, safety.Stage.BRAKING)
        if (result.scale > 0.99 or not commanded) and result.stage in harmless:
            return ''
        fastest = self.robot.acceleration_max * dt * (1.0 - 1e-6)
        at_limit = [i for i in result.joints
                    if abs(result.dq[i] - self._previous[i]) < fastest[i]]
        if len(result.joints) and not at_limit and not len(result.pairs):  # speeding up
            return ''
        names = [f"joint '{self.robot.joint_names[i]}' at its limit" for i in at_limit]
        pairs = pair_names() if len(result.pairs) else []
        names += [pairs[i] for i in result.pairs]
        return f'{result.stage.value}: {", ".join(names) or "singular posture"}'

    def _reach(self, dt: float) -> tuple[float, Array]:
        """Return the barriers' rate [1/s] and the fastest the joints may move next tick (n,)."""
        robot = self.robot
        stop = safety.stopping_time(self._previous, robot.acceleration_max) + dt
        fastest = np.minimum(
            np.abs(self._previous) + robot.acceleration_max * dt, robot.velocity_max)
        rate = safety.barrier_rate(self._parameters.barrier_gain, stop, dt)
        return rate, fastest

    def _nearest(self, maps: Whitening, pairs: Pairs, scene: Scene) -> Nearest | None:
        if not pairs.clearance.size:
            return None
        distances = pairs.clearance / maps.steepest
        link, obstacle = divmod(int(distances.argmin()), len(scene.names))
        return Nearest(
            self.robot.capsules[link].name, scene.names[obstacle],
            float(pseudo_distance(pairs.clearance[link, obstacle])),
            float(distances[link, obstacle]))


def _size(vector: Array) -> float:
    """Return the Euclidean norm; np.linalg.norm takes four times as long on a few numbers."""
    return math.sqrt(vector @ vector)

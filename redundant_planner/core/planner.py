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

from redundant_planner.core import drift, indices, null_space, safety
from redundant_planner.core.broad_phase import FEW, Surroundings, surroundings
from redundant_planner.core.drift import Pose
from redundant_planner.core.errors import ParameterError, StateError
from redundant_planner.core.horizon import continued, Horizon, node_times, poses_ahead, TwistAhead
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
# Entries of a twist beyond this are cut back before anything is computed with them.
_ABSURD = 1e100
# A speed limit of 0 counts as this, for the sake of a division [m/s, rad/s].
_STANDSTILL = 1e-12
# Steps of the horizon in the very first tick: two surveys, some 50 ms.
_FIRST_STEPS = 100
# An arm is found inside a margin when it is deeper in than what linearisation may cost [m].
_FOUND_INSIDE = 1e-3
# Over how long the trend of a held command is averaged [s].
_TREND = 0.1
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
    """The pairs of links and obstacles that count in a tick.

    Attributes:
        links, obstacles: (p,) indices.
        clearance: (p,) ρ.
        distance: (p,) not more than the true distance [m].
        gradient: (p, n) ∂ρ/∂q.
        rate: (p,) ∂ρ/∂t from the obstacles' own motion [1/s].
        acts: (p,) whether the pair's barrier could act in this tick.
    """

    links: npt.NDArray[np.intp]
    obstacles: npt.NDArray[np.intp]
    clearance: Array
    distance: Array
    gradient: Array
    rate: Array
    acts: npt.NDArray[np.bool_]

    def acting(self) -> _Near:
        """Return those whose barrier could act."""
        acts = self.acts
        return _Near(self.links[acts], self.obstacles[acts], self.clearance[acts],
                     self.distance[acts], self.gradient[acts], self.rate[acts], acts[acts])


class _Pace(NamedTuple):
    """How far a tick can lead.

    Attributes:
        rate: share of a reserve that may be used up per second [1/s].
        fastest: (n,) the fastest the joints may move [rad/s, m/s].
    """

    rate: float
    fastest: Array


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
        clearance_index: H_w over what is within the influence distance; infinite where nothing
            is.
        nearest: the nearest pair, None without obstacles; of many obstacles that are all further
            away than matters, it may be another's than the nearest.
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
        # Only the joints between two links bring these nearer to each other.
        self._self_moves = robot.moves[robot.self_pairs[:, 0]] - robot.moves[
            robot.self_pairs[:, 1]]
        self._self_levers = np.abs(self._self_moves) * robot.levers[robot.self_pairs].max(axis=1)
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
        self._horizons = tuple(
            Horizon(robot, node_times(duration, parameters.horizon_nodes), self._scaling,
                    robot.position_min + margin, robot.position_max - margin)
            for duration in (parameters.horizon, parameters.horizon_held))
        self._horizon: Horizon | None = None
        self._limits = safety.Limits(
            np.array((robot.position_max - margin, robot.position_min + margin)),
            robot.velocity_max, robot.acceleration_max, margin)
        self._maps_of = None
        self._around: Surroundings | None = None

    def reset(self) -> None:
        """Forget the last velocity and the reference pose: the arm stands where it is found."""
        self._previous = np.zeros(self.robot.n)
        self._path_velocity: Array = np.zeros(self.robot.m)
        self._reference: Pose | None = None
        self._self_known = None
        self._command: Array = np.zeros(6)
        self._growth = 0.0
        self._horizon = None
        self._around = None

    @property
    def reference(self) -> Pose | None:
        """Where the tip should be now; None before the first tick after a reset."""
        return self._reference

    def prepare(self, scene: Scene) -> None:
        """Do what a scene new to `step` costs ahead of it, where there is time for that."""
        if self._maps_of is None or self._maps_of[0] is not scene:
            self._maps_of = scene, whitening(
                scene, self._radii + self._parameters.clearance_margin)

    def step(
        self, q: Array, twist: Array, scene: Scene, dt: float, ahead: TwistAhead | None = None,
    ) -> StepResult:
        """Return the joint velocity for the next `dt`.

        Args:
            q: (n,) measured joint positions [rad, m].
            twist: (6,) commanded tip twist in the command frame [m/s, rad/s]; entries of axes
                that are not controlled do not count.
            scene: the obstacles. Pass the same object while nothing changes.
            dt: time until the next tick [s].
            ahead: what will be commanded, times from now (N,) [s] → twists (N, 6), for the
                variational method; None if only the present command is known, which is then
                held.

        Raises:
            StateError: `q` or `twist` does not fit the robot, or `dt` is not positive.
        """
        robot, p = self.robot, self._parameters
        command = self._checked_command(twist, dt)
        first = self._reference is None
        arm = robot.kinematics(q)

        # ẋ: the command plus what brings the tip back to the reference pose (§ drift).
        pose = Pose(arm.tip_position, arm.tip_rotation)
        error = self._path_error(pose)
        correction = drift.feedback(error, p.drift_gain, p.drift_speed, p.drift_angular_speed)
        if not command.any() and float(np.abs(error).max()) < _AT_REST:
            correction = np.zeros(6)
        turning: Array = np.zeros(robot.m)
        if p.drift_gain > 0.0:
            # J turns while the arm moves: half of that belongs to the tick ahead.
            turning = 0.5 * dt * robot.jacobian_rate_times(arm, self._previous)
        task = robot.task_rows(command + correction) - turning

        # J⁺ẋ, in coordinates in which every joint costs the same.
        parts = null_space.decompose(arm.jacobian * self._scaling)
        gains = null_space.inverse_gains(
            parts.singular_values, p.damping_threshold, p.damping)
        least_norm = null_space.least_norm(parts, gains, task)

        # ∇H, Eq. 18, and k P∇H, Eqs. 1 and 2.
        pace = self._pace(dt)
        self.prepare(scene)
        around, maps, pairs = self._clearances(arm, scene, pace)
        near = self._near(arm, maps, pairs, pace)
        shortest = None
        if p.method == 'variational':
            shortest = self._shortest_path(arm, command, ahead, first, dt)
        level, clearance = self._clearance_gradient(arm, near, scene)
        fallback = p.method == 'variational' and shortest is None
        if shortest is not None:
            factor, projected = 1.0, null_space.project(parts, shortest / self._scaling)
        else:
            gradient = self._total_gradient(arm, clearance, parts, gains, least_norm, task)
            projected = null_space.project(parts, gradient * self._scaling)
            factor = p.k_fixed
            if p.method != 'gradient_projection':
                factor = null_space.dynamic_factor(
                    p.k_alpha, _size(least_norm), _size(projected))
        least_norm = self._scaling * least_norm
        homogeneous = self._scaling * (factor * projected)
        dq = least_norm + homogeneous  # Eq. 1

        scale, stage, reason = 1.0, safety.Stage.DESIRED, ''
        followed = arm.jacobian @ dq - task + robot.task_rows(command)
        if p.safety_filter:
            result, reason = self._filtered(
                dq, parts, arm, command, correction, turning, near, around, pace, dt)
            dq, scale, stage = result.dq, result.scale, result.stage
            # What was followed of the path; neither the way back to it nor what was yielded.
            followed = scale * robot.task_rows(command) + result.coast * self._path_velocity

        if fallback:
            reason = '; '.join(filter(None, (
                'no joint path ahead was found: dynamic_factor steps in', reason)))
        assert self._reference is not None
        self._reference = drift.integrate(
            self._reference, robot.full_twist(followed), dt, robot.command_frame)
        self._path_velocity = followed
        self._previous = dq
        return StepResult(
            dq.copy(), least_norm, homogeneous, factor, scale, stage, reason, level,
            self._nearest(pairs, around), parts.manipulability, pose, error)

    def _checked_command(self, twist: Array, dt: float) -> Array:
        """Return the controlled part of the twist, no faster than the speed limits."""
        command = np.array(twist, dtype=float)
        if command.shape != (6,) or not np.isfinite(command).all():
            raise StateError(f'twist is {command.tolist()}; it takes six finite numbers '
                             '[m/s, rad/s]')
        if not (np.isfinite(dt) and dt > 0.0):
            raise StateError(f'dt is {dt}; it must be positive [s]')
        if self.robot.m < 6:
            command[~self._controlled] = 0.0
        linear_max, angular_max = (
            self._parameters.linear_speed_max, self._parameters.angular_speed_max)
        vx, vy, vz, wx, wy, wz = command.tolist()
        # Bounded first: the norm of an absurd twist would overflow.
        excess = max(abs(vx), abs(vy), abs(vz), abs(wx), abs(wy), abs(wz)) / _ABSURD
        if excess > 1.0:
            return self._checked_command(command / excess, dt)
        # A limit of 0 lets nothing pass.
        return command / max(math.hypot(vx, vy, vz) / max(linear_max, _STANDSTILL),
                             math.hypot(wx, wy, wz) / max(angular_max, _STANDSTILL), 1.0)

    def _path_error(self, pose: Pose) -> Array:
        """Return the error against the reference, nothing on axes that are not controlled.

        A reference that is out of reach, or has drifted on those axes, is brought along.
        """
        if self._reference is None:
            self._reference = pose
            return np.zeros(6)
        frame, p = self.robot.command_frame, self._parameters
        error = drift.pose_error(self._reference, pose, frame)
        if self.robot.m < 6:
            error[~self._controlled] = 0.0
        kept = drift.bounded(error, p.drift_distance, p.drift_angle)
        if self.robot.m < 6 or kept is not error:
            self._reference = drift.displaced(pose, kept, frame)
        return kept

    def _shortest_path(
        self, arm: Kinematics, command: Array, ahead: TwistAhead | None, first: bool, dt: float,
    ) -> Array | None:
        """Return the velocity (n,) of the shortest joint path ahead, None where there is none.

        A profile that is known from the very first tick on, when the arm is at rest and nobody
        waits for a command yet, is planned thoroughly.
        """
        if self.robot.n == self.robot.m:
            return np.zeros(self.robot.n)
        growth = self._growth_of(command, dt)
        assert self._reference is not None
        horizon = self._horizons[ahead is None]
        if horizon is not self._horizon:
            self._horizon = horizon
            horizon.reset()

        def twist_ahead(times: Array) -> Array:
            if ahead is None:
                return continued(command, growth, times)
            return np.where(self._controlled, ahead(times), 0.0)

        poses = poses_ahead(
            self._reference, twist_ahead, horizon.times, self.robot.command_frame)
        steps = _FIRST_STEPS if first and ahead is not None else 1
        assert self._maps_of is not None
        return horizon.advance(arm.q, poses, self._maps_of[1], dt, steps)

    def _growth_of(self, command: Array, dt: float) -> float:
        """Return the rate at which the command has been growing or fading lately [1/s]."""
        size = float(command @ command)
        if size == 0.0 or not self._command.any():
            self._growth = 0.0
        else:
            rate = float((command - self._command) @ command) / (size * dt)
            self._growth += (1.0 - math.exp(-dt / _TREND)) * (rate - self._growth)
        self._command = command
        return self._growth

    def _clearances(
        self, arm: Kinematics, scene: Scene, pace: _Pace,
    ) -> tuple[Scene, Whitening, Pairs]:
        """Return every link × every obstacle that can matter; links carry the clearance margin."""
        assert self._maps_of is not None
        maps, ends = self._maps_of[1], (arm.segment_start, arm.segment_end)
        if len(scene.names) < FEW:
            return scene, maps, link_clearance(maps, *ends)
        fastest_obstacle = float(maps.speeds.max())
        reach = np.maximum((self.robot.levers @ pace.fastest + fastest_obstacle) / pace.rate,
                           self._parameters.influence_distance)
        if self._around is None or not self._around.hold(
                scene, arm.q, self.robot.levers, reach):
            self._around = surroundings(
                scene, maps, link_clearance(maps, *ends), arm.q, reach)
        around = self._around
        return around.near, around.maps, link_clearance(around.maps, *ends)

    def _near(self, arm: Kinematics, maps: Whitening, pairs: Pairs, pace: _Pace) -> _Near:
        """Return the pairs that count in this tick, all of them, and their gradients.

        Those are the pairs within the influence distance, and those whose barrier could act: no
        point of a link moves faster than Σ |q̇_j| lever_j.
        """
        speeds = (self.robot.levers @ pace.fastest)[:, None] + maps.speeds
        acts = pairs.distance <= speeds / pace.rate
        near = (acts | (pairs.distance <= self._parameters.influence_distance)).nonzero()
        gradient, rate = clearance_gradients(
            maps, pairs, near, arm.segment_start, arm.segment_end, arm.columns,
            self.robot.moves)
        links, obstacles = near
        return _Near(
            links, obstacles, pairs.clearance[near], pairs.distance[near], gradient, rate,
            acts[near])

    def _clearance_gradient(
        self, arm: Kinematics, near: _Near, scene: Scene,
    ) -> tuple[float, Array]:
        """Return H_w of Eq. 7 and ∇H_w, over whole links or, as the paper does, over joints."""
        p, robot = self._parameters, self.robot
        clearance, distance, gradient = near.clearance, near.distance, near.gradient
        if p.clearance_points == 'joints':
            points = robot.joint_points(arm.q)
            maps = whitening(scene, np.zeros(len(points)))
            pairs = link_clearance(maps, points, points)
            clearance, distance = pairs.clearance.ravel(), pairs.distance.ravel()
            every = np.isfinite(pairs.clearance).nonzero()
            gradient, _ = clearance_gradients(
                maps, pairs, every, points, points, arm.columns,
                moves=np.tril(np.ones((len(points), robot.n))))
        level, slopes = indices.clearance_index(
            clearance, distance, smoothing=p.clearance_smoothing,
            influence_distance=p.influence_distance)
        return level, slopes @ gradient

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
                least_norm, dual, robot.jacobian_derivative_times(arm, self._scaling * least_norm))
        manipulability: Array = np.zeros(robot.n)
        nearness = parts.singular_values[-1] / max(p.singularity_margin, 1e-9) - 1.0
        if p.k_m > 0.0 and nearness < 1.0:
            changes = np.array([
                left @ robot.jacobian_derivative_times(arm, self._scaling * right)
                for left, right in zip(parts.left.T, parts.right)])
            _, manipulability = indices.manipulability_index(parts, changes)
            manipulability = indices.fade(nearness) * manipulability
        return indices.total_gradient(
            clearance, joint_limit, shortest_path, manipulability, k_w=p.k_w, k_s=p.k_s,
            k_f=p.k_f, k_m=p.k_m)

    def _filtered(
        self, desired: Array, parts: null_space.Decomposition, arm: Kinematics,
        command: Array, correction: Array, turning: Array, near: _Near, scene: Scene,
        pace: _Pace, dt: float,
    ) -> tuple[safety.Filtered, str]:
        """Pass the desired velocity through the safety filter and name what acted."""
        p = self._parameters
        if not near.acts.all():
            near = near.acting()
        may_yield = p.path_priority == 'yield' and bool(
            ((near.distance < -_FOUND_INSIDE) | (near.rate < 0.0)).any())
        own, own_gradient, distance = self._self_clearances(arm, pace)
        singular, reserve = self._singularity(arm, parts)
        still = np.zeros(len(own) + len(reserve))
        barriers = safety.Barriers(
            np.concatenate((near.gradient, own_gradient, singular)),
            np.concatenate((near.rate, still)),
            np.concatenate((near.clearance, distance, reserve)), soft=len(reserve))
        result = safety.safe_velocity(
            desired, bool(parts.singular_values[-1] >= p.damping_threshold), arm.jacobian,
            self.robot.task_rows(command + correction), arm.q, self._previous, self._limits,
            barriers, weights=self._weights, gain=p.barrier_gain, may_yield=may_yield, dt=dt,
            feedback=self.robot.task_rows(correction), turning=turning)
        return result, self._reason(
            result, bool(command.any()), lambda: self._pair_names(near, own, scene), dt)

    def _singularity(
        self, arm: Kinematics, parts: null_space.Decomposition,
    ) -> tuple[Array, Array]:
        """Return the gradient (1, n) of J's smallest singular value σ and its reserve (1,).

        With σ's directions u and v, ∂σ/∂q_k = uᵀ (∂J/∂q_k) v. Closer than the margin the arm
        may stay where it is; it only may not get closer. Nothing, (0, n), where σ is large.
        """
        margin, smallest = self._parameters.singularity_margin, parts.singular_values[-1]
        if smallest > _SINGULARITY_NEAR * margin:
            return np.empty((0, self.robot.n)), np.empty(0)
        columns = self.robot.jacobian_derivative_times(arm, self._scaling * parts.right[-1])
        return ((parts.left[:, -1] @ columns)[None],
                np.array([max(float(smallest) - margin, 0.0)]))

    def _self_clearances(
        self, arm: Kinematics, pace: _Pace,
    ) -> tuple[npt.NDArray[np.intp], Array, Array]:
        """Return the pairs of links that may meet in this tick, their gradients and distances.

        Links found closer than the margin may stay so, they only may not get closer: capsules
        are fatter than links, and an arm must not start to move by itself because of it.
        """
        robot, margin = self.robot, self._parameters.self_collision_margin
        nothing = _NO_PAIRS, np.empty((0, robot.n)), np.empty(0)
        if margin <= -1.0 or not len(robot.self_pairs):
            return nothing
        # A pair's distance falls by no more than the joints between its links have moved: as
        # long as that settles it, nothing needs to be measured.
        reach = (self._self_levers @ pace.fastest) / pace.rate
        if self._self_known is not None:
            known_at, known = self._self_known
            if (known - self._self_levers @ np.abs(arm.q - known_at) > reach).all():
                return nothing
        pairs = link_distances(
            arm.segment_start, arm.segment_end, self._radii + margin / 2.0, robot.self_pairs)
        self._self_known = arm.q, pairs.distance
        near = (pairs.distance <= reach).nonzero()[0]
        if not len(near):
            return nothing
        gradient = distance_gradients(pairs, near, arm.columns, self._self_moves)
        return near, gradient, np.maximum(pairs.distance[near], 0.0)

    def _pair_names(
        self, near: _Near, own: npt.NDArray[np.intp], scene: Scene,
    ) -> list[str]:
        """Name the barriers in their order, as sentences' parts."""
        names = [capsule.name for capsule in self.robot.capsules]
        found = [f"link '{names[link]}' near obstacle '{scene.names[obstacle]}'"
                 for link, obstacle in zip(near.links, near.obstacles)]
        found += [f"link '{names[i]}' near link '{names[j]}'"
                  for i, j in self.robot.self_pairs[own]]
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

    def _pace(self, dt: float) -> _Pace:
        """Return the barriers' rate and how fast the joints may move after this tick."""
        robot = self.robot
        stop = safety.stopping_time(self._previous, robot.acceleration_max) + dt
        fastest = np.minimum(
            np.abs(self._previous) + robot.acceleration_max * dt, robot.velocity_max)
        return _Pace(safety.barrier_rate(self._parameters.barrier_gain, stop, dt), fastest)

    def _nearest(self, pairs: Pairs, scene: Scene) -> Nearest | None:
        if not pairs.clearance.size:
            return None
        link, obstacle = divmod(int(pairs.distance.argmin()), len(scene.names))
        return Nearest(
            self.robot.capsules[link].name, scene.names[obstacle],
            float(pseudo_distance(pairs.clearance[link, obstacle])),
            float(pairs.distance[link, obstacle]))


def _size(vector: Array) -> float:
    """Return the Euclidean norm; np.linalg.norm takes four times as long on a few numbers."""
    return math.sqrt(vector @ vector)

"""One tick of the planner: state, command and scene in, joint velocity out.

The only composition in the package: `Planner.step` around `_desired`, where every line is an
equation of the paper or a section of docs/derivations.md and docs/safety.md.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ParameterError, StateError
from redundant_planner.core.horizon.horizon import Horizon
from redundant_planner.core.horizon.least_norm_path import PathJoints
from redundant_planner.core.horizon.poses_ahead import middles, node_times, poses_ahead
from redundant_planner.core.horizon.preview import continued, TwistAhead
from redundant_planner.core.kernels import (
    compiled,
    Fields,
    IndexPairs,
    Indices,
    kernel,
    Matrix,
    OutMatrix,
    OutVector,
    Vector,
)
from redundant_planner.core.obstacles.clearance import (
    clearance_gradients,
    link_clearance,
    pseudo_distance,
)
from redundant_planner.core.obstacles.evasion import Evasion, NO_TURN, Turn
from redundant_planner.core.obstacles.inflation import inflated_ellipsoids, InflatedEllipsoids
from redundant_planner.core.obstacles.near_pairs import near_pairs, NearPairs
from redundant_planner.core.obstacles.nearby import everything, FEW, Surroundings, surroundings
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import near_links, NearLinks, SelfPairs
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.redundancy import criteria, null_space
from redundant_planner.core.redundancy.null_space import Decomposition
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.jacobian import derivative_between, jdot_qdot
from redundant_planner.core.robot.kinematics import Kinematics, Links
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.safety import safety_filter as safety

Array = npt.NDArray[np.float64]

# An arm that is not commanded and this close to where it should be is left in peace [m, rad].
_AT_REST = 1e-5
# The singularity barrier is looked at below this multiple of its margin.
_SINGULARITY_NEAR = 5.0
# Entries of a twist beyond this are cut back before anything is computed with them.
_ABSURD = 1e100
# A speed limit of 0 counts as this, for the sake of a division [m/s, rad/s].
_STANDSTILL = 1e-12
# An arm is found inside a margin when it is deeper in than what linearisation may cost [m].
_FOUND_INSIDE = 1e-3
# How far the tip may leave its path while null-space motion is being braked [m], [rad].
_STRAY, _STRAY_ANGLE = 2.5e-4, 2.5e-3
# How exactly a turn is made, as a share of a joint's speed limit.
_SLIP = 0.005
# Over how long the trend of a held command is averaged [s].
_TREND = 0.1
# The joint path ahead is improved at most this often [s]: it takes a sixth of a millisecond.
_PLANNING_PERIOD = 0.003
# Among more obstacles than this dynamic_factor does without it.
_CROWD = 50
# A tick in which evasion has looked at so many distances has no time to improve that path.
_SEARCHING = 7500
# A command smaller than this is none, as to how it grows [squared m/s, rad/s].
_NO_SPEED = 1e-24
# How soon dynamic_factor follows the joint path ahead once it has to, and how soon it stops [s],
# down to which share while it might come of use again.
_HANDING_OVER, _HANDING_BACK, _WATCHING = 0.1, 1.0, 1e-3


class Nearest(NamedTuple):
    """The link and obstacle with the smallest level value.

    Attributes:
        link, obstacle: their names.
        level: S of Eq. 6 over the whole link, 0 at the safety margin and what is kept from the
            obstacle for its motion.
        distance: [m] not more than the true distance beyond the margin; negative inside.
    """

    link: str
    obstacle: str
    level: float
    distance: float


class _Arm(NamedTuple):
    """What stays the same from tick to tick about the robot.

    Attributes:
        position_min, position_max, velocity_max, acceleration_max: (n,) see `Robot`.
        scaling: (n,) 1 / square root of the joint weights.
        levers, moves: (c, n) see `Robot`.
        radii: (c,) of the links, half the self-collision margin included [m].
        self_pairs: (p, 2) links that can run into each other; none if that is switched off.
        self_moves, self_levers: (p, n) see `near_links`.
        rows: (m,) the controlled ones of the six axes.
        in_tool: whether J and twists are in tool axes.
        positions, position_margin: see `safety.Limits`.
    """

    position_min: Vector
    position_max: Vector
    velocity_max: Vector
    acceleration_max: Vector
    scaling: Vector
    levers: Matrix
    moves: Matrix
    radii: Vector
    self_pairs: IndexPairs
    self_moves: Matrix
    self_levers: Matrix
    rows: Indices
    in_tool: bool
    positions: Matrix
    position_margin: float


class _Settings(NamedTuple):
    """Parameters that a tick takes; `PlannerParameters` says what they mean."""

    k_w: float
    k_s: float
    k_f: float
    k_m: float
    k_alpha: float
    k_fixed: float
    clearance_smoothing: float
    influence_distance: float
    look_ahead: float
    damping_threshold: float
    damping: float
    singularity_margin: float
    obstacle_lead: float
    evasion_horizon: float
    barrier_gain: float
    drift_gain: float
    drift_speed: float
    drift_angular_speed: float
    drift_distance: float
    drift_angle: float


class _Task(NamedTuple):
    """What the tip shall do in a tick, in the controlled axes of the command frame.

    Attributes:
        wanted: (m,) the command.
        back: (m,) what leads back to the reference pose.
        turning: (m,) what comes of J's turning within the tick, ½ dt J̇ q̇.
        error: (6,) reference pose minus the tip's.
        position, rotation: the reference pose, which is brought along when it is out of reach.
    """

    wanted: Vector
    back: Vector
    turning: Vector
    error: Vector
    position: Vector
    rotation: Matrix


class _Barriers(NamedTuple):
    """What must not be used up in a tick.

    Attributes:
        gradient: see `safety.Barriers`.
        terms: (3, b) their drift, reserve and spare, see there.
        soft: how many of the last are not urgent, see there: one that keeps away from a
            singularity, and one on the speed of null-space motion.
        near_singular: whether the former is among them.
        intruded: whether an obstacle moves towards the arm, or the arm was found too close.
        pairs: (a + k, 2) links and obstacles, then links and links, that the others are about.
        acting, outer: how many of these are about obstacles that are near, and about any.
    """

    gradient: Matrix
    terms: Matrix
    soft: int
    near_singular: bool
    intruded: bool
    pairs: IndexPairs
    acting: int
    outer: int


class _Desired(NamedTuple):
    """What the method asks for, and what the safety filter needs to know.

    Attributes:
        dq: (n,) Eq. 1.
        least_norm, homogeneous, factor, clearance_index, manipulability: see `StepResult`.
        barriers, task: see there.
        nearest_link, nearest_obstacle, nearest_clearance, nearest_distance: see `NearPairs`.
        admissible: whether `dq` breaks no limit and no barrier.
        blocked: whether the least-norm motion, gone on with, leads into something.
        unseen_share: see there.
    """

    dq: Vector
    least_norm: Vector
    homogeneous: Vector
    factor: float
    clearance_index: float
    manipulability: float
    barriers: Fields[_Barriers]
    task: Fields[_Task]
    nearest_link: int
    nearest_obstacle: int
    nearest_clearance: float
    nearest_distance: float
    admissible: bool
    blocked: bool
    unseen_share: float


class StepResult(NamedTuple):
    """What one tick decided; arrays are the caller's to keep.

    Attributes:
        dq: (n,) joint velocity command [rad/s, m/s].
        least_norm: (n,) J⁺ẋ of this tick.
        homogeneous: (n,) k P∇H of this tick, or what leads along the joint path ahead.
        factor: k of Eq. 1; 1 where a joint path ahead gives all null-space motion.
        scale: s, the share of the commanded twist that is followed.
        stage: how the safety filter came to `dq`.
        reason: one sentence: what slows or stops the arm; empty when nothing does.
        fallback: which bound on a tick's work was reached, and what was done instead; empty if
            none was. It is part of the reason.
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
    fallback: str
    clearance_index: float
    nearest: Nearest | None
    manipulability: float
    pose: Pose
    path_error: Array


class Planner:
    """Velocity-level redundancy resolution for one robot.

    Between ticks it remembers the last joint velocity, the reference pose, the joint path ahead,
    the turn that is being made to evade something and when the links were last measured against
    each other, nothing else: the same sequence of inputs gives the same sequence of outputs.
    """

    def __init__(self, robot: Robot, parameters: PlannerParameters) -> None:
        """Prepare for a robot.

        Raises:
            ParameterError: the parameters do not fit this robot.
        """
        self.robot = robot
        self._scene: Scene | None = None
        self._fastest = 0.0  # of the scene's obstacles [m/s]
        self._radii = np.array([c.radius for c in robot.capsules])
        self._controlled = robot.full_twist(np.ones(robot.m))
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
        self._weights = weights
        self._limits = safety.Limits(
            np.array((robot.position_max - margin, robot.position_min + margin)),
            robot.velocity_max, robot.acceleration_max, margin)
        self._scaling = 1.0 / np.sqrt(weights)
        self._arm: tuple[Any, ...] = tuple(_constants(
            robot, self._scaling, self._limits, self._radii, parameters.self_collision_margin))
        self._settings = tuple(float(getattr(parameters, name)) for name in _Settings._fields)
        self._forget_links()
        self._horizons = tuple(
            Horizon(robot, node_times(duration, parameters.horizon_nodes), PathJoints(
                self._scaling, robot.position_min + margin, robot.position_max - margin))
            for duration in (parameters.horizon, parameters.horizon_held))
        self._forget_path()
        self._evasion = Evasion(robot, parameters)
        self._around: Surroundings | None = None
        # Of the last tick: where the arm was, and the tick's length.
        self._last: tuple[Kinematics, float] | None = None

    def reset(self) -> None:
        """Forget the last velocity and the reference pose: the arm stands where it is found."""
        self._previous: Array = np.zeros(self.robot.n)
        self._path_velocity: Array = np.zeros(self.robot.m)
        self._reference: Pose | None = None
        self._forget_links()
        self._forget_path()
        self._evasion.reset()
        self._leaving = False
        self._around = self._last = None

    def _forget_links(self) -> None:
        """Forget where the links were last measured against each other."""
        self._known_at = np.full(self.robot.n, np.nan)
        self._known = np.empty(len(_Arm(*self._arm).self_pairs))

    def _forget_path(self) -> None:
        """Forget the joint path ahead, and what it was planned for."""
        self._horizon: Horizon | None = None
        self._path: Array | None = None
        self._planned = 0.0  # how long ago
        self._guided = 0.0  # share of the null-space motion that follows it
        self._command: Array = np.zeros(6)
        self._growth = 0.0

    @property
    def reference(self) -> Pose | None:
        """Where the tip should be now; None before the first tick after a reset."""
        return self._reference

    def prepare(self, scene: Scene) -> None:
        """Do what a scene new to `step` costs ahead of it, where there is time for that."""
        if scene is not self._scene:
            squares = np.square(scene.velocities).sum(axis=1)
            self._scene, self._fastest = scene, math.sqrt(squares.max(initial=0.0))
            if self._last is not None:
                self._surroundings(scene, *self._last)

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
            ahead: what will be commanded, times from now (N + 1,) [s] → mean twists (N, 6) from
                each to the next, for the joint path ahead; None if only the present command
                is known, which is then held.

        Raises:
            StateError: `q` or `twist` does not fit the robot, or `dt` is not positive.
        """
        robot, p = self.robot, self._parameters
        command, commanded = self._checked_command(twist, dt)
        arm = robot.kinematics(q)
        pose = Pose(arm.tip_position, arm.tip_rotation)
        reference = pose if self._reference is None else self._reference

        # What there is to evade, and the way around it.
        self.prepare(scene)
        around = self._surroundings(scene, arm, dt)
        maps = around.maps
        self._last = arm, dt
        turn = NO_TURN
        if (self._fastest > 0.0 and p.safety_filter and p.path_priority == 'yield'
                and p.evasion_horizon > 0.0):
            turn = self._evasion.turn(arm, around.ahead, self._previous, self._leaving, dt)
        else:
            self._evasion.reset()
        shortest, guided = None, 1.0 if p.method == 'variational' else self._guided
        if guided > 0.0:
            shortest = self._shortest_path(arm, reference, command, ahead, around.ahead, dt)
        fallbacks = []
        if p.method == 'variational' and shortest is None:
            fallbacks.append('no joint path ahead was found: dynamic_factor steps in')

        # ẋ and J⁺ẋ + k P∇H: Eqs. 1, 2 and 18.
        by_joints = self._clearance_over_joints(arm, scene)
        desired = _Desired(*_desired(
            tuple(arm), *reference, command, tuple(maps), self._arm, self._settings,
            self._previous, around.q, around.range, self._known_at, self._known,
            p.method == 'gradient_projection',
            *((0.0, self._previous) if shortest is None else (guided, shortest)),
            by_joints is not None, *(by_joints or (0.0, self._previous)),
            tuple(turn), dt))

        if p.method == 'dynamic_factor' and p.safety_filter:
            blocked = (commanded or self._fastest > 0.0) and desired.blocked
            if blocked and len(around.near) > _CROWD:
                fallbacks.append(f'no joint path is planned among more than {_CROWD} obstacles')
            self._hand_over(blocked and len(around.near) <= _CROWD, dt)

        dq, scale, stage, reason = desired.dq, 1.0, safety.Stage.DESIRED, ''
        task = _Task(*desired.task)
        followed = task.wanted
        if not p.safety_filter:
            followed = arm.jacobian @ dq + task.turning - task.back
        elif not desired.admissible:
            result = self._filtered(desired, arm, dt)
            dq, scale, stage = result.dq, result.scale, result.stage
            reason = self._reason(result, commanded, desired, around, dt)
            # What was followed of the path; neither the way back to it nor what was yielded.
            followed = scale * task.wanted + result.coast * self._path_velocity
            fallbacks += [f'out of iterations where {stage.value}' for stage in result.cut_short]
            if desired.unseen_share < 1.0:
                fallbacks.append(
                    'slower among more obstacles than a tick takes in: '
                    f'{desired.unseen_share:.0%} of the speed')
        if self._horizon is not None and self._horizon.cut_short:
            fallbacks.append('the joint path ahead was improved in part')

        _take_along(task.position, task.rotation, followed, robot.rows, robot.in_tool, dt)
        self._reference = Pose(task.position, task.rotation)
        self._path_velocity = followed
        self._previous = dq
        self._leaving = stage in (safety.Stage.YIELDING, safety.Stage.FORCED)
        return StepResult(
            dq.copy(), desired.least_norm, desired.homogeneous, desired.factor, scale, stage,
            '; '.join(filter(None, (*fallbacks, reason))), '; '.join(fallbacks),
            desired.clearance_index, self._nearest(desired, around),
            desired.manipulability, pose, task.error)

    def _checked_command(self, twist: Array, dt: float) -> tuple[Array, bool]:
        """Return the controlled part of the twist, no faster than the speed limits.

        And whether there is any.
        """
        command = np.array(twist, dtype=float)
        if command.shape != (6,) or not all(map(math.isfinite, command.tolist())):
            raise StateError(f'twist is {command.tolist()}; it takes six finite numbers '
                             '[m/s, rad/s]')
        if not (math.isfinite(dt) and dt > 0.0):
            raise StateError(f'dt is {dt}; it must be positive [s]')
        commanded = _limit_speed(command, self._controlled, self._parameters.linear_speed_max,
                                 self._parameters.angular_speed_max)
        return command, commanded

    def _hand_over(self, blocked: bool, dt: float) -> None:
        """Have dynamic_factor follow the joint path ahead, gradually, while it is blocked itself.

        Where that path leads nowhere either, it is only kept an eye on.
        """
        if blocked and (self._horizon is None or self._horizon.free):
            self._guided = min(self._guided + dt / _HANDING_OVER, 1.0)
        elif self._guided > 0.0:
            least = _WATCHING if blocked else 0.0
            self._guided = max(self._guided - dt / _HANDING_BACK, least)
            if self._guided == 0.0:
                self._forget_path()

    def _shortest_path(
        self, arm: Kinematics, reference: Pose, command: Array, ahead: TwistAhead | None,
        maps: InflatedEllipsoids, dt: float,
    ) -> Array | None:
        """Return the velocity (n,) of the shortest joint path ahead, None where there is none.

        Args:
            arm, reference: where the arm is, and where its tip should be.
            command, ahead, dt: see `step`.
            maps: the nearest obstacles.
        """
        if self.robot.n <= self.robot.m:
            return np.zeros(self.robot.n)
        self._planned += dt
        if self._path is not None and (
                self._planned < _PLANNING_PERIOD or self._evasion.spent > _SEARCHING):
            return self._path
        elapsed, self._planned = self._planned, 0.0
        growth = self._growth_of(command, elapsed)
        horizon = self._horizons[ahead is None]
        if horizon is not self._horizon:
            self._horizon = horizon
            horizon.reset()

        times = horizon.times
        if ahead is None:
            twists = continued(command, growth, middles(times))
        else:
            twists = self._controlled * ahead(times)
        task = _task(arm, reference, command, self._previous, _Arm(*self._arm), self._settings,
                     dt)
        poses = poses_ahead(Pose(task.position, task.rotation), twists, times, self.robot.in_tool)
        self._path = horizon.advance(arm.q, poses, maps, elapsed)
        return self._path

    def _growth_of(self, command: Array, dt: float) -> float:
        """Return the rate at which the command has been growing or fading lately [1/s]."""
        size = float(command @ command)
        if size < _NO_SPEED or not self._command.any():
            self._growth = 0.0
        else:
            rate = float((command - self._command) @ command) / (size * dt)
            self._growth += (1.0 - math.exp(-dt / _TREND)) * (rate - self._growth)
        self._command = command
        return self._growth

    def _surroundings(self, scene: Scene, arm: Kinematics, dt: float) -> Surroundings:
        """Return the obstacles that can matter, for links with the clearance margin."""
        around, p = self._around, self._parameters
        if around is not None and around.scene is scene and around.complete:
            return around
        radii = self._radii + p.clearance_margin
        if len(scene.names) < FEW:
            self._around = everything(scene, radii, p.obstacle_lead, arm.q)
            return self._around
        reach = _reach(self._previous, self._fastest, self._arm, self._settings, dt)
        if around is None or not around.hold(
                scene, arm.q, self.robot.lever_arm_bounds, reach):
            self._around = around = surroundings(
                scene, radii, p.obstacle_lead, arm, reach, p.evasion_horizon)
        return around

    def _clearance_over_joints(
        self, arm: Kinematics, scene: Scene,
    ) -> tuple[float, Array] | None:
        """Return H_w of Eq. 7 and ∇H_w over the joints, as the paper has it, if asked for."""
        p, robot = self._parameters, self.robot
        if p.clearance_points != 'joints':
            return None
        points = robot.joint_points(arm.q)
        maps = inflated_ellipsoids(scene, np.zeros(len(points)))
        pairs = link_clearance(maps, points, points)
        every = np.isfinite(pairs.normalized_distance).nonzero()
        gradient, _ = clearance_gradients(maps, pairs, every, Links(
            points, points, arm.joint_screws, np.tril(np.ones((len(points), robot.n)))))
        return criteria.clearance_index(
            pairs.normalized_distance.ravel(), pairs.distance.ravel(), gradient,
            p.clearance_smoothing, p.influence_distance)

    def _filtered(
        self, desired: _Desired, arm: Kinematics, dt: float,
    ) -> safety.Filtered:
        """Return what comes nearest to a desired velocity that breaks a limit or a barrier."""
        p, task, found = self._parameters, _Task(*desired.task), _Barriers(*desired.barriers)
        drifts, reserves, spare = found.terms
        limits = self._limits
        if desired.unseen_share < 1.0:
            limits = limits._replace(velocity_max=_slowed(
                self._previous, limits.velocity_max, limits.acceleration_max,
                desired.unseen_share, dt))
        return safety.safe_velocity(
            desired.dq, False, arm.jacobian, task.wanted + task.back, arm.q, self._previous,
            limits, safety.Barriers(found.gradient, drifts, reserves, found.soft, spare),
            weights=self._weights, gain=p.barrier_gain,
            may_yield=found.intruded and p.path_priority == 'yield', dt=dt, feedback=task.back,
            turning=task.turning)

    def _reason(
        self, result: safety.Filtered, commanded: bool, desired: _Desired,
        around: Surroundings, dt: float,
    ) -> str:
        """Say what holds the arm back; the drives' own way to speed up and stop does not count."""
        harmless = (safety.Stage.DESIRED, safety.Stage.SCALED, safety.Stage.BRAKING)
        if (result.scale > 0.99 or not commanded) and result.stage in harmless:
            return ''
        fastest = dt * (1.0 - 1e-6)
        at_limit = [i for i in result.joints.tolist() if abs(result.dq[i] - self._previous[i])
                    < fastest * self.robot.acceleration_max[i]]
        if len(result.joints) and not at_limit and not len(result.pairs):  # speeding up
            return ''
        names = [f"joint '{self.robot.joint_names[i]}' at its limit" for i in at_limit]
        names += [self._barrier_name(i, desired, around) for i in result.pairs.tolist()]
        return f'{result.stage.value}: {", ".join(names) or "singular posture"}'

    def _barrier_name(
        self, barrier: int, desired: _Desired, around: Surroundings,
    ) -> str:
        """Name a barrier as a sentence's part."""
        found, capsules = _Barriers(*desired.barriers), self.robot.capsules
        if barrier == len(found.pairs) and found.near_singular:
            return 'near a singularity'
        if barrier >= len(found.pairs):
            return 'null-space motion that could not stop without leaving the path'
        link, other = found.pairs[barrier].tolist()
        if barrier < found.outer:
            index = around.near if barrier < found.acting else around.nearest
            obstacle = around.scene.names[index[other]]
            return f"link '{capsules[link].name}' near obstacle '{obstacle}'"
        return f"link '{capsules[link].name}' near link '{capsules[other].name}'"

    def _nearest(self, desired: _Desired, around: Surroundings) -> Nearest | None:
        if desired.nearest_link < 0:
            return None
        obstacle = desired.nearest_obstacle
        lead = self._parameters.obstacle_lead * float(around.maps.speeds[obstacle])
        return Nearest(
            self.robot.capsules[desired.nearest_link].name,
            around.scene.names[around.near[obstacle]],
            pseudo_distance(desired.nearest_clearance), desired.nearest_distance + lead)


def _constants(
    robot: Robot, scaling: Array, limits: safety.Limits, radii: Array, self_margin: float,
) -> _Arm:
    # Only the joints between two links bring these nearer to each other.
    pairs = robot.self_pairs if self_margin > -1.0 else robot.self_pairs[:0]
    moves = robot.supports[pairs[:, 0]] - robot.supports[pairs[:, 1]]
    return _Arm(
        np.array(robot.position_min), np.array(robot.position_max),
        np.array(robot.velocity_max), np.array(robot.acceleration_max), scaling,
        np.array(robot.lever_arm_bounds), np.array(robot.supports), radii + self_margin / 2.0,
        np.array(pairs), moves, np.abs(moves) * robot.lever_arm_bounds[pairs].max(axis=1),
        np.array(robot.rows), robot.in_tool, limits.positions, limits.margin)


@compiled
def _task(
    arm: Kinematics, reference: Pose, command: Vector, previous: Vector, constants: _Arm,
    settings: Fields[_Settings], dt: float,
) -> _Task:
    """Return what the tip shall do in this tick: ẋ.

    A reference that is out of reach, or has drifted on axes that are not controlled, is brought
    along.
    """
    p, rows = _Settings(*settings), constants.rows
    pose = Pose(arm.tip_position, arm.tip_rotation)
    apart = se3.pose_error(reference, pose, constants.in_tool)
    error = np.zeros(6)
    for row in rows:
        error[row] = apart[row]
    kept = se3.bounded(error, p.drift_distance, p.drift_angle)
    if len(rows) < 6 or (kept != error).any():
        reference = se3.displaced(pose, kept, constants.in_tool)
    correction = se3.feedback(kept, p.drift_gain, p.drift_speed, p.drift_angular_speed)
    if np.abs(command).max() == 0.0 and np.abs(kept).max() < _AT_REST:
        correction[:] = 0.0
    wanted, back, turning = np.zeros((3, len(rows)))
    for i in range(len(rows)):
        wanted[i], back[i] = command[rows[i]], correction[rows[i]]
    if p.drift_gain > 0.0:
        # J turns while the arm moves: half of that belongs to the tick ahead.
        turning[:] = 0.5 * dt * jdot_qdot(
            arm.tip_jacobian, previous, arm.tip_rotation, constants.in_tool, rows)
    return _Task(wanted, back, turning, kept, reference.position, reference.rotation)


@compiled
def _take_along(
    position: OutVector, rotation: OutMatrix, followed: Vector, rows: Indices, in_tool: bool,
    dt: float,
) -> None:
    """Move a reference pose by what was followed of the path, (m,)."""
    twist = np.zeros(6)
    for i in range(len(rows)):
        twist[rows[i]] = followed[i]
    pose = se3.integrate(Pose(position.copy(), rotation.copy()), twist, dt, in_tool)
    position[:], rotation[:] = pose


@kernel
def _pace(
    previous: Vector, constants: Fields[_Arm], settings: Fields[_Settings], dt: float,
) -> tuple[Array, Array, float]:
    """Return how far this tick can lead.

    Returns:
        (n,) the fastest the joints may move [rad/s, m/s], (c,) the fastest any point of a link
        may then move, Σ |q̇_j| lever_j [m/s], and the share of a reserve that may be used up
        per second [1/s].
    """
    constants, p = _Arm(*constants), _Settings(*settings)
    n = len(previous)
    fastest, speeds = np.empty(n), np.zeros(len(constants.levers))
    for j in range(n):
        fastest[j] = min(abs(previous[j]) + constants.acceleration_max[j] * dt,
                         constants.velocity_max[j])
        for link in range(len(speeds)):
            speeds[link] += constants.levers[link, j] * fastest[j]
    stop = safety.stopping_time(previous, constants.acceleration_max) + dt
    return fastest, speeds, safety.barrier_rate(p.barrier_gain, stop, dt)


@compiled
def _reach(
    previous: Vector, fastest: float, constants: Fields[_Arm], settings: Fields[_Settings],
    dt: float,
) -> Array:
    """Return how near an obstacle must be to each link to matter in this tick, (c,) [m].

    Args:
        previous, constants, settings, dt: as for `_pace`.
        fastest: speed of the fastest obstacle [m/s].
    """
    _, speeds, rate = _pace(previous, constants, settings, dt)
    p = _Settings(*settings)
    least = max(p.influence_distance, p.evasion_horizon * fastest)
    return np.maximum((speeds + fastest) / rate, least)


@kernel
def _unseen(
    q: Vector, levers: Matrix, range_at: Vector, ranges: Vector,
) -> Array:
    """Return how near to a link an obstacle may be that is not looked at, (c,) [m].

    Args:
        q: (n,) the posture.
        levers: (c, n) of the links.
        range_at, ranges: where and what the surroundings' range is, see `Surroundings`.
    """
    unseen = ranges.copy()
    for link in range(len(unseen)):
        for j in range(len(q)):
            unseen[link] -= levers[link, j] * abs(q[j] - range_at[j])
    return unseen


@kernel
def _unseen_share(unseen: Vector, speeds: Vector, rate: float) -> float:
    """Return the share of the fastest motion that keeps clear of what is not looked at.

    A link that moves no faster than `rate` times its distance from it keeps its barrier.

    Args:
        unseen: (c,) how near such an obstacle may be to a link [m].
        speeds, rate: from `_pace`.
    """
    share = 1.0
    for link in range(len(speeds)):
        if rate * unseen[link] < speeds[link]:
            share = min(share, max(rate * unseen[link], 0.0) / speeds[link])
    return share


@compiled
def _slowed(
    previous: Vector, velocity_max: Vector, acceleration_max: Vector, share: float, dt: float,
) -> Array:
    """Return limits (n,) of the velocity that keep to a share of the fastest motion.

    But not below what proportional braking can reach.
    """
    limits, still = np.empty(len(previous)), safety.braked(previous, acceleration_max, dt)
    for j in range(len(limits)):
        fastest = min(abs(previous[j]) + acceleration_max[j] * dt, velocity_max[j])
        limits[j] = max(share * fastest, abs(still[j]))
    return limits


@compiled
def _fastest_sway(arm: Kinematics, sway: Vector, constants: _Arm) -> float:
    """Return how fast null-space motion h may be to stop next to the path [rad/s, m/s].

    All joints slowing in proportion within T, the tip is accelerated by J̇ h while h lasts, and
    has been moved aside by |J̇ h| T²/8 at the end (docs/safety.md). That grows with the fourth
    power of the speed. Infinite where h is far from that.
    """
    rate = jdot_qdot(
        arm.tip_jacobian, sway, arm.tip_rotation, constants.in_tool, constants.rows)
    squared, squared_angle = 0.0, 0.0
    for i in range(len(rate)):
        if constants.rows[i] < 3:
            squared += rate[i] * rate[i]
        else:
            squared_angle += rate[i] * rate[i]
    stop = safety.stopping_time(sway, constants.acceleration_max)
    aside = stop * stop / 8.0 * max(
        math.sqrt(squared) / _STRAY, math.sqrt(squared_angle) / _STRAY_ANGLE)
    # A tick adds less than a tenth to a speed at which this matters.
    if aside < 0.6:
        return np.inf
    return math.sqrt(np.sum(sway * sway)) / aside ** 0.25


@kernel
def _blocked(
    near: NearPairs, q: Vector, motion: Vector, positions: Matrix, look_ahead: float,
) -> bool:
    """Return whether a motion (n,), gone on with, leads into an obstacle or a joint limit.

    Clearances and positions are taken to go on changing as they do, for `look_ahead` [s].
    """
    if look_ahead == 0.0:
        return False
    for i in range(len(near.normalized_distance)):
        rate = near.rate[i]
        for j in range(len(motion)):
            rate += near.gradient[i, j] * motion[j]
        if near.normalized_distance[i] + look_ahead * rate < 0.0:
            return True
    for j in range(len(motion)):
        if not positions[1, j] <= q[j] + look_ahead * motion[j] <= positions[0, j]:
            return True
    return False


@kernel
def _total_gradient(
    arm: Kinematics, clearance: Vector, parts: Decomposition, gains: Vector, least_norm: Vector,
    twist: Vector, constants: _Arm, p: _Settings,
) -> Array:
    """Return ∇H of Eq. 18; an index of no weight costs nothing."""
    scaling = constants.scaling
    joint_limit, shortest_path, manipulability = np.zeros((3, len(scaling)))
    if p.k_s > 0.0:
        _, joint_limit = criteria.joint_limit_index(
            arm.q, constants.position_min, constants.position_max)
    if p.k_f > 0.0:
        _, shortest_path = criteria.shortest_path_index(least_norm, derivative_between(
            null_space.dual(parts, gains, twist), arm.tip_jacobian, scaling * least_norm,
            arm.tip_rotation, constants.in_tool, constants.rows))
    nearness = parts.singular_values[-1] / max(p.singularity_margin, 1e-9) - 1.0
    if p.k_m > 0.0 and nearness < 1.0:
        changes = np.empty(parts.right.shape)
        for i in range(len(changes)):
            changes[i] = derivative_between(
                parts.left[:, i], arm.tip_jacobian, scaling * parts.right[i],
                arm.tip_rotation, constants.in_tool, constants.rows)
        _, manipulability = criteria.manipulability_index(parts, changes)
        manipulability = criteria.fade(nearness) * manipulability
    return criteria.total_gradient(
        clearance, joint_limit, shortest_path, manipulability,
        criteria.IndexWeights(p.k_w, p.k_s, p.k_f, p.k_m))


@kernel
def _barriers(
    arm: Kinematics, parts: Decomposition, near: NearPairs, own: NearLinks, turn: Turn,
    previous: Vector, constants: _Arm, maps: InflatedEllipsoids, p: _Settings, dt: float,
) -> _Barriers:
    """Return what keeps the arm off obstacles, itself and singularities, and from whipping.

    With the singular value's directions u and v, ∂σ/∂q_k = uᵀ (∂J/∂q_k) v. Closer than the
    margin the arm may stay where it is; it only may not get closer. Where the first joints have to
    turn, two barriers hold each to its velocity.
    """
    scaling, smallest = constants.scaling, parts.singular_values[-1]
    acting, turning, inner = len(near.acting), len(turn.velocities), len(own.pairs)
    outer = acting + 2 * turning
    intruded = turning > 0
    for at in near.acting:
        intruded = intruded or near.distance[at] < -_FOUND_INSIDE or near.rate[at] < 0.0
    near_singular = smallest <= _SINGULARITY_NEAR * p.singularity_margin
    # Who has to evade shall do so in the null space, at any speed, rather than leave the path.
    sway = scaling * null_space.project(parts, previous / scaling)
    fastest_sway = np.inf if intruded else _fastest_sway(arm, sway, constants)
    soft = int(near_singular) + int(fastest_sway < np.inf)

    count = outer + inner
    gradient, pairs = np.empty((count + soft, len(previous))), np.empty((count, 2), np.intp)
    terms = np.zeros((3, count + soft))
    drifts, reserves, spare = terms
    for i in range(acting):
        at = near.acting[i]
        gradient[i] = near.gradient[at]
        drifts[i], reserves[i] = near.rate[at], near.normalized_distance[at]
        link, obstacle = near.links[at], near.obstacles[at]
        spare[i] = p.obstacle_lead * maps.speeds[obstacle] / maps.smallest[link, obstacle]
        pairs[i, 0], pairs[i, 1] = link, obstacle
    for i in range(acting, outer):
        j, way = (i - acting) // 2, 1.0 - 2.0 * ((i - acting) % 2)
        gradient[i] = 0.0
        gradient[i, j] = way
        drifts[i] = _SLIP * constants.velocity_max[j] - way * turn.velocities[j]
        pairs[i, 0], pairs[i, 1] = turn.link, turn.obstacle
    for i in range(inner):
        gradient[outer + i], reserves[outer + i] = own.gradient[i], own.distance[i]
        pairs[outer + i] = constants.self_pairs[own.pairs[i]]
    if near_singular:
        gradient[count] = derivative_between(
            parts.left[:, -1], arm.tip_jacobian, scaling * parts.right[-1], arm.tip_rotation,
            constants.in_tool, constants.rows)
        reserves[count] = max(smallest - p.singularity_margin, 0.0)
    if fastest_sway < np.inf:
        # h·q̇ / |h| may be that much at most, whatever the rate of the other barriers.
        speed = math.sqrt(np.sum(sway * sway))
        slower = 1.0 - dt / max(safety.stopping_time(previous, constants.acceleration_max), dt)
        gradient[-1] = -sway / speed
        drifts[-1] = max(fastest_sway, slower * np.sum(sway * previous) / speed)
    return _Barriers(gradient, terms, soft, near_singular, intruded, pairs, acting, outer)


@compiled
def _desired(
    arm: Fields[Kinematics], position: Vector, rotation: Matrix, command: Vector,
    maps: Fields[InflatedEllipsoids], constants: Fields[_Arm], settings: Fields[_Settings],
    previous: Vector, range_at: Vector, ranges: Vector, known_at: OutVector, known: OutVector,
    fixed_gain: bool, guided: float, path: Vector, by_joints: bool,
    joint_clearance_index: float, joint_clearance: Vector, turn: Fields[Turn], dt: float,
) -> Fields[_Desired]:
    """Return J⁺ẋ + k P∇H, and the barriers around it.

    Args:
        arm, maps, constants, settings: see there.
        position, rotation: of the reference pose.
        command: (6,) the twist [m/s, rad/s].
        previous: (n,) velocity of the last tick.
        range_at, ranges: see `_unseen`.
        known_at, known: see `near_links`.
        fixed_gain: whether k is k_fixed instead of Eq. 2's.
        guided, path: the share of the homogeneous solution that is the null-space part of a
            velocity (n,) of the shortest joint path; and it.
        by_joints, joint_clearance_index, joint_clearance: H_w and ∇H_w to be used instead of
            those over whole links.
        turn: of the first joints, out of an obstacle's course.
        dt: [s].
    """
    arm, maps, plain = Kinematics(*arm), InflatedEllipsoids(*maps), constants
    constants, p = _Arm(*constants), _Settings(*settings)
    scaling = constants.scaling

    # ẋ: the command plus what brings the tip back to the reference pose (§ drift).
    task = _task(arm, Pose(position.copy(), rotation.copy()), command, previous, constants,
                 settings, dt)

    # J⁺ẋ, in coordinates in which every joint costs the same.
    parts = null_space.decompose(arm.jacobian * scaling)
    gains = null_space.inverse_gains(parts.singular_values, p.damping_threshold, p.damping)
    twist = task.wanted + task.back - task.turning
    least_norm = null_space.least_norm(parts, gains, twist)

    # What the arm may come close to in this tick.
    fastest, speeds, rate = _pace(previous, plain, settings, dt)
    links = Links(arm.segment_start, arm.segment_end, arm.joint_screws, constants.moves)
    near = near_pairs(
        maps, links, speeds, rate, p.influence_distance,
        _unseen(arm.q, constants.levers, range_at, ranges))
    unseen_share = _unseen_share(near.unseen, speeds, rate)
    self_pairs = SelfPairs(constants.radii, constants.self_pairs, constants.self_moves,
                           constants.self_levers)
    own = near_links(arm.q, links, self_pairs, fastest, rate, known_at, known)

    # k P∇H, Eqs. 1, 2 and 18.
    level, clearance = criteria.clearance_index(
        near.normalized_distance, near.distance, near.gradient, p.clearance_smoothing,
        p.influence_distance)
    if by_joints:
        level, clearance = joint_clearance_index, joint_clearance.copy()
    factor, homogeneous = 1.0, np.zeros(len(path))
    if guided < 1.0:
        gradient = _total_gradient(arm, clearance, parts, gains, least_norm, twist, constants, p)
        projected = null_space.project(parts, gradient * scaling)
        factor = p.k_fixed if fixed_gain else null_space.dynamic_factor(
            p.k_alpha, least_norm, projected)
        homogeneous = (1.0 - guided) * factor * projected
    if guided > 0.0:
        homogeneous += guided * null_space.project(parts, path / scaling)

    least_norm, homogeneous = scaling * least_norm, scaling * homogeneous
    dq = least_norm + homogeneous  # Eq. 1

    barriers = _barriers(arm, parts, near, own, Turn(*turn), previous, constants, maps, p, dt)
    smallest = parts.singular_values[-1]
    admissible = unseen_share == 1.0 and smallest >= p.damping_threshold and safety.admissible(
        dq, arm.q, previous, constants.positions, constants.velocity_max,
        constants.acceleration_max, constants.position_margin, barriers.gradient,
        barriers.terms[0], barriers.terms[1], p.barrier_gain, dt)
    # As plain tuples: they are handed back sooner, too.
    return _Desired(
        dq, least_norm, homogeneous, factor, level, null_space.manipulability(parts),
        barriers[:], task[:], near.nearest_link, near.nearest_obstacle,
        near.nearest_normalized_distance, near.nearest_distance, admissible,
        _blocked(near, arm.q, least_norm, constants.positions, p.look_ahead), unseen_share)[:]


@compiled
def _limit_speed(
    command: OutVector, controlled: Vector, linear_max: float, angular_max: float,
) -> bool:
    """Take a twist's uncontrolled part away and slow it down to the limits; is any left?"""
    largest = 0.0
    for i in range(6):
        command[i] *= controlled[i]
        largest = max(largest, abs(command[i]))
    if largest == 0.0:
        return False
    # The norm of an absurd twist would overflow.
    scale = largest if largest > _ABSURD else 1.0
    excess = 1.0 / scale
    for part in range(2):
        x, y, z = command[3 * part:3 * part + 3] / scale
        # A limit of 0 lets nothing pass.
        limit = max(angular_max if part else linear_max, _STANDSTILL)
        excess = max(excess, math.sqrt(x * x + y * y + z * z) / limit)
    for i in range(6):
        command[i] = command[i] / scale / excess
    return True

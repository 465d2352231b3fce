"""What users would pick instead, on the very same arm: mink and pink, driven tick by tick.

Both get the joint limits of position and velocity, this package's capsules and obstacles, the
same pairs of links that shall not meet, and the pose where the tip should be after the tick.
Neither limits accelerations; that is in their favour. They come with `pip install mink pin-pink`
(see CONTRIBUTING.md), for benchmarks only.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from typing import Protocol

import coal
import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pink
from pink.barriers import SelfCollisionBarrier
from pink.exceptions import NoSolutionFound
from pink.limits import ConfigurationLimit, VelocityLimit
import pinocchio as pin

from benchmark.bodies import rotation_to, shape_of
from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, ELLIPSOID, Obstacle
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

# A share of the task's weight on every joint: without it the least norm is not well defined.
_DAMPING = 1e-8
# Distance from which mink looks at a pair [m], and pink's barrier gain [1/s].
_DETECTION = 0.1
_PINK_GAIN = 5.0
_SOLVER = 'daqp'
# A shape in MuJoCo's words; a capsule whose segment is shorter is a sphere [m].
_GEOMS = {ELLIPSOID: 'ellipsoid', BOX: 'box', CYLINDER: 'cylinder', CAPSULE: 'capsule'}
_LEAST_LENGTH = 1e-6


class Peer(Protocol):
    """A library bound to one arm and one set of obstacles."""

    def step(self, q: Array, target: Pose, dt: float) -> Array:
        """Return the joint velocities (n,) towards a tip pose that is due after `dt`.

        Zero where the library finds no solution.
        """

    def move(self, obstacles: Sequence[Obstacle]) -> None:
        """Take the same obstacles' new places."""


def versions() -> dict[str, str]:
    """Return the versions of what is compared."""
    return {name: version(name) for name in ('mink', 'mujoco', 'pin-pink', 'pin', 'daqp')}


class Mink:
    """mink with its frame task, its limits and its collision avoidance."""

    def __init__(
        self, robot: Robot, obstacles: Sequence[Obstacle], margin: float, self_margin: float,
    ) -> None:
        """Build the MuJoCo model; margins to obstacles and between links in [m]."""
        self._model = mujoco.MjModel.from_xml_string(mjcf(robot, obstacles))
        self._configuration = mink.Configuration(self._model)
        position, rotation = _costs(robot)
        self._task = mink.FrameTask('tip', 'site', position, rotation)
        links = [f'link{i}' for i in range(len(robot.capsules))]
        self._limits = [
            mink.ConfigurationLimit(self._model),
            mink.VelocityLimit(self._model, dict(zip(
                robot.joint_names, robot.velocity_max.tolist()))),
        ]
        others = [f'obstacle{i}' for i in range(len(obstacles))]
        own = [([links[i]], [links[j]]) for i, j in robot.self_pairs]
        for pairs, distance in (([(links, others)], margin), (own, self_margin)):
            if pairs and all(first and second for first, second in pairs):
                self._limits.append(mink.CollisionAvoidanceLimit(
                    self._model, pairs, minimum_distance_from_collisions=distance,
                    collision_detection_distance=_DETECTION))

    def step(self, q: Array, target: Pose, dt: float) -> Array:
        """See `Peer`."""
        self._configuration.update(q)
        self._task.set_target(mink.SE3.from_rotation_and_translation(
            mink.SO3.from_matrix(target.rotation), target.position))
        try:
            return np.array(mink.solve_ik(
                self._configuration, [self._task], dt, _SOLVER, damping=_DAMPING,
                limits=self._limits))
        except mink.NoSolutionFound:
            return np.zeros(len(q))

    def move(self, obstacles: Sequence[Obstacle]) -> None:
        """See `Peer`."""
        for i, obstacle in enumerate(obstacles):
            x, y, z, w = obstacle.orientation
            self._configuration.data.mocap_pos[i] = obstacle.center
            self._configuration.data.mocap_quat[i] = w, x, y, z


class Pink:
    """pink with its frame task, its limits and its collision barrier."""

    def __init__(
        self, robot: Robot, obstacles: Sequence[Obstacle], margin: float, self_margin: float,
    ) -> None:
        """Add the capsules and obstacles to Pinocchio's geometry model; margins as for `Mink`.

        pink's barrier knows one margin for all pairs, that to obstacles: among themselves the
        links are as much thinner as makes it theirs.
        """
        self._robot, self._model = robot, robot.model.copy()
        self._model.velocityLimit = robot.velocity_max
        geometry = pin.GeometryModel()
        links = _add_links(geometry, robot, 'link', 0.0)
        own = _add_links(geometry, robot, 'own_link', 0.5 * (margin - self_margin))
        for one, other in robot.self_pairs.tolist():
            geometry.addCollisionPair(pin.CollisionPair(own[one], own[other]))
        self._obstacle_ids = []
        for i, obstacle in enumerate(obstacles):
            body = geometry.addGeometryObject(pin.GeometryObject(
                f'obstacle{i}', 0, pin.SE3(obstacle.rotation, obstacle.center),
                shape_of(obstacle)))
            self._obstacle_ids.append(body)
            for link in links:
                geometry.addCollisionPair(pin.CollisionPair(link, body))
        self._configuration = pink.Configuration(
            self._model, self._model.createData(), pin.neutral(self._model),
            collision_model=geometry)
        position, rotation = _costs(robot)
        self._task = pink.FrameTask(robot.tip_frame, position, rotation)
        self._barriers = [SelfCollisionBarrier(
            len(geometry.collisionPairs), gain=_PINK_GAIN, safe_displacement_gain=0.0,
            d_min=margin)] if len(geometry.collisionPairs) else []
        self._limits = [ConfigurationLimit(self._model, 1.0), VelocityLimit(self._model)]

    def step(self, q: Array, target: Pose, dt: float) -> Array:
        """See `Peer`."""
        self._configuration.update(q)
        self._task.set_target(pin.SE3(target.rotation, target.position))
        try:
            return np.array(pink.solve_ik(
                self._configuration, [self._task], dt, _SOLVER, damping=_DAMPING,
                limits=self._limits, barriers=self._barriers, safety_break=False))
        except NoSolutionFound:
            return np.zeros(len(q))

    def move(self, obstacles: Sequence[Obstacle]) -> None:
        """See `Peer`."""
        for body, obstacle in zip(self._obstacle_ids, obstacles):
            self._configuration.collision_model.geometryObjects[body].placement = pin.SE3(
                obstacle.rotation, obstacle.center)


def _add_links(
    geometry: pin.GeometryModel, robot: Robot, name: str, thinner: float,
) -> list[int]:
    """Add the capsules, their radii less by so much [m], and return their indices."""
    indices = []
    for i, capsule in enumerate(robot.capsules):
        joint, start, end = _in_joint(robot, capsule)
        shape = coal.Capsule(
            max(capsule.radius - thinner, 1e-5), max(_distance(start, end), 1e-6))
        indices.append(geometry.addGeometryObject(pin.GeometryObject(
            f'{name}{i}', joint, pin.SE3(rotation_to(end - start), 0.5 * (start + end)), shape)))
    return indices


def mjcf(robot: Robot, obstacles: Sequence[Obstacle]) -> str:
    """Return the arm's chain, its capsules and the obstacles as a MuJoCo model."""
    model = robot.model
    shapes: dict[int, list[str]] = {}
    for i, capsule in enumerate(robot.capsules):
        joint, start, end = _in_joint(robot, capsule)
        radius = max(capsule.radius, 1e-5)
        shape = (f'type="sphere" size="{radius}" pos="{_text(start)}"'
                 if _distance(start, end) < 1e-6 else
                 f'type="capsule" size="{radius}" fromto="{_text(start)} {_text(end)}"')
        shapes.setdefault(joint, []).append(f'<geom name="link{i}" {shape}/>')
    body = ''.join(shapes.get(0, []))
    for i in range(1, robot.n + 1):
        placement, joint = model.jointPlacements[i], model.joints[i]
        subspace = np.array(joint.createData().S).reshape(6)
        turning = bool(np.any(subspace[3:]))
        low, high = robot.position_min[i - 1], robot.position_max[i - 1]
        limited = np.isfinite(low) and np.isfinite(high)
        reach = f'limited="true" range="{low} {high}"' if limited else 'limited="false"'
        body += (
            f'<body {_placed(placement)}><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
            f'<joint name="{robot.joint_names[i - 1]}" type="{"hinge" if turning else "slide"}" '
            f'axis="{_text(subspace[3:] if turning else subspace[:3])}" {reach}/>'
            + ''.join(shapes.get(i, [])))
    tip = model.frames[model.getFrameId(robot.tip_frame)].placement
    body += f'<site name="tip" {_placed(tip)}/>' + '</body>' * robot.n
    for i, obstacle in enumerate(obstacles):
        at = pin.SE3(obstacle.rotation, obstacle.center)
        body += f'<body mocap="true" {_placed(at)}>{_geom(f"obstacle{i}", obstacle)}</body>'
    return ('<mujoco><compiler angle="radian"/>'
            f'<worldbody>{body}</worldbody></mujoco>')


def _geom(name: str, obstacle: Obstacle) -> str:
    """Return an obstacle as MuJoCo's geom of the same shape; its sizes are halves, too."""
    kind = _GEOMS[obstacle.shape]
    x, y, z = obstacle.half_extents.tolist()
    if obstacle.shape == CAPSULE and z - x < _LEAST_LENGTH:
        kind = 'sphere'
    sizes = {'sphere': (x,), 'cylinder': (x, z), 'capsule': (x, z - x)}.get(kind, (x, y, z))
    return f'<geom name="{name}" type="{kind}" size="{_text(np.array(sizes))}"/>'


def _in_joint(robot: Robot, capsule: Capsule) -> tuple[int, Array, Array]:
    """Return a capsule's joint and its ends in that joint's frame."""
    frame = robot.model.frames[robot.model.getFrameId(capsule.frame)]
    return (int(frame.parentJoint), frame.placement.act(np.array(capsule.start)),
            frame.placement.act(np.array(capsule.end)))


def _costs(robot: Robot) -> tuple[list[float], list[float]]:
    cost = robot.full_twist(np.ones(robot.m))
    return cost[:3].tolist(), cost[3:].tolist()


def _distance(a: Array, b: Array) -> float:
    return float(np.linalg.norm(b - a))


def _text(values: Array) -> str:
    return ' '.join(repr(float(value)) for value in values)


def _placed(placement: pin.SE3) -> str:
    x, y, z, w = pin.Quaternion(placement.rotation).coeffs()
    return f'pos="{_text(placement.translation)}" quat="{_text(np.array([w, x, y, z]))}"'

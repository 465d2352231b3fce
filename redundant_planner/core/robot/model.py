"""A serial chain read from a URDF, and its kinematics at one posture (Pinocchio)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.errors import known, ObstacleError, RobotError, shown, StateError
from redundant_planner.core.kernels import (
    compiled,
    Fields,
    Indices,
    Matrix,
    OutMatrix,
    OutStack,
    OutVector,
    Stack,
    Stacks,
    Vector,
)
from redundant_planner.core.numbers import floats_of
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.parameters import AXES, COMMAND_FRAMES
from redundant_planner.core.robot.urdf import Joint, LARGEST, MOVABLE, read_urdf, Urdf

Array = npt.NDArray[np.float64]

# How pairs of links are chosen for self-collision: random postures looked at, the share of them
# above which an overlap is by construction, and the distance [m] that counts as never near.
_PAIR_SAMPLES = 500
_TOUCH_SHARE = 0.1
_NEVER_NEAR = 0.02

# No arm has more joints, or more capsules: every one of them costs time in every tick.
_MOST_JOINTS = 50
_MOST_CAPSULES = 500
# The planner's arithmetic keeps its digits within these [rad/s, m/s; per s²].
_SLOWEST, _FASTEST = 1e-6, 1e6


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


class Kinematics(NamedTuple):
    """The arm at one posture; everything is expressed in the base frame.

    Attributes:
        q: (n,) joint positions [rad, m].
        columns: (6, n) joint screws [v; w], v taken at the base origin [m/s, rad/s per unit q̇].
        tip_position: (3,) [m].
        tip_rotation: (3, 3) tip axes in the base frame.
        tip_jacobian: (6, n) of the tip point, base axes (LOCAL_WORLD_ALIGNED).
        jacobian: (m, n) the controlled rows, in the command frame: J of the paper.
        segment_start: (c, 3) first ends of the capsules [m].
        segment_end: (c, 3) second ends of the capsules [m].
    """

    q: Vector
    columns: Matrix
    tip_position: Vector
    tip_rotation: Matrix
    tip_jacobian: Matrix
    jacobian: Matrix
    segment_start: Matrix
    segment_end: Matrix


class Robot:
    """A chain of n joints from a base frame to a tip frame.

    Attributes:
        name: the URDF's robot name.
        urdf: the URDF text it was built from.
        base_frame, tip_frame: frame names.
        joint_names: the n chain joints, base first.
        axes: the m controlled axes, a subset of `AXES` in that order.
        command_frame: 'base' or 'tool': the frame in which a twist, and so J, is expressed.
        in_tool: whether that is the tool frame.
        rows: (m,) which of the six axes are controlled.
        position_min, position_max: (n,) [rad, m], infinite for continuous joints.
        velocity_max, acceleration_max: (n,) [rad/s, m/s; per s²].
        capsules: the link shapes.
        self_pairs: (p, 2) indices of the capsules that can run into each other.
        moves: (c, n) 1 where a joint moves a capsule, else 0.
        chain: the fields of `Chain`.
        levers: (c, n) the fastest any point of a capsule moves per unit of joint velocity, at any
            posture: a bound [m/rad, 1 for prismatic joints].
    """

    def __init__(
        self,
        urdf: str,
        tip_frame: str,
        *,
        base_frame: str = '',
        locked_positions: Mapping[str, float] | None = None,
        axes: Sequence[str] = AXES,
        command_frame: str = 'base',
        velocity_max: Sequence[float] | float | None = None,
        acceleration_max: Sequence[float] | float = 5.0,
        capsules: Sequence[Capsule] | None = None,
        link_radius: float | None = None,
    ) -> None:
        """Read the chain from a URDF.

        Args:
            urdf: the URDF's text (not its path).
            tip_frame: the link whose origin is the end effector.
            base_frame: the link that commands, obstacles and poses refer to; the root link
                if empty.
            locked_positions: joint name → position at which it is held [rad, m]. Joints
                outside the chain are held at 0 (or the nearest limit) unless given here.
                A chain joint named here is taken out of the chain.
            axes: controlled axes, out of `AXES`.
            command_frame: 'base' or 'tool', see the class.
            velocity_max: replaces the URDF's velocity limits, one value or n [rad/s, m/s].
            acceleration_max: one value or n [rad/s², m/s²] (a URDF has none).
            capsules: the link shapes; an empty list leaves every link unprotected.
            link_radius: where `capsules` is None, the radius of straight capsules from each
                joint origin to the next [m]; 0 for bare lines.

        Raises:
            RobotError: the URDF is malformed, a name is unknown, the frames do not form a
                chain, a limit or axis makes no sense, or neither `capsules` nor `link_radius`
                is given.
            ObstacleError: a capsule is not a valid shape.
        """
        self.urdf = urdf
        described = read_urdf(urdf)
        self.name: str = described.name
        self.base_frame = base_frame or described.root
        self.tip_frame = tip_frame
        chain = _chain(described, self.base_frame, tip_frame, locked_positions or {})
        self._model = _model_of_chain(described, chain, self.base_frame, locked_positions or {})
        self._data = self._model.createData()
        self.joint_names: tuple[str, ...] = tuple(self._model.names)[1:]
        self.axes = _checked_axes(axes)
        if command_frame not in COMMAND_FRAMES:
            raise RobotError(
                f"command_frame is '{command_frame}'; it must be one of {known(COMMAND_FRAMES)}")
        self.command_frame = command_frame
        self.in_tool = command_frame == 'tool'
        self.position_min, self.position_max = (
            _read_only(np.array(ends)) for ends in zip(*_ranges(chain)))
        self.velocity_max = self._limits(
            'velocity_max', self._model.velocityLimit if velocity_max is None else velocity_max)
        self.acceleration_max = self._limits('acceleration_max', acceleration_max)

        self._tip_id = _link_id(self._model, tip_frame)
        self.rows = np.array([AXES.index(axis) for axis in self.axes], dtype=np.intp)
        # Of a single joint Pinocchio shows J as a vector.
        self._joints = (self._data.J.T.reshape(-1, 6), *_placements(self._data))
        self.capsules = tuple(
            self._default_capsules(link_radius) if capsules is None else capsules)
        if len(self.capsules) > _MOST_CAPSULES:
            raise RobotError(f'{len(self.capsules)} capsules are more than the planner can keep '
                             f'an eye on; give {_MOST_CAPSULES} at most')
        self._place_capsules()
        tip = self._model.frames[self._tip_id]
        self.chain: tuple[Any, ...] = tuple(Chain(
            int(tip.parentJoint), np.array(tip.placement.rotation, order='C'),
            np.array(tip.placement.translation), self._capsule_joint, self._capsule_ends,
            self.rows, self.in_tool))
        self.levers = self._levers()
        self.self_pairs = self._self_pairs()

    @property
    def n(self) -> int:
        """Number of chain joints."""
        return len(self.joint_names)

    @property
    def m(self) -> int:
        """Number of controlled axes."""
        return len(self.axes)

    @property
    def moving_links(self) -> dict[str, str]:
        """The links that chain joints move → the joint that carries each."""
        model = self._model
        return {frame.name: model.names[frame.parentJoint] for frame in model.frames
                if frame.type == pin.FrameType.BODY and frame.parentJoint > 0}

    def in_link(self, target: str, source: str, points: Array) -> Array:
        """Return points (k, 3) given in one link's frame in another's on the same joint [m]."""
        model = self._model
        there, here = (model.frames[_link_id(model, name)].placement
                       for name in (target, source))
        change = there.inverse() * here
        return points @ change.rotation.T + change.translation

    def in_base(self, q: npt.ArrayLike, link: str, points: Array) -> Array:
        """Return points (k, 3) given in a moving link's frame in the base frame [m].

        Raises:
            StateError: `q` does not have n finite entries.
        """
        pin.forwardKinematics(self._model, self._data, self.checked_posture(q))
        pose = pin.updateFramePlacement(self._model, self._data, _link_id(self._model, link))
        return points @ pose.rotation.T + pose.translation

    @property
    def model(self) -> pin.Model:
        """The chain as Pinocchio holds it, in the base frame; not to be changed."""
        return self._model

    def kinematics(self, q: npt.ArrayLike) -> Kinematics:
        """Return the arm's kinematics at `q`.

        Args:
            q: (n,) joint positions [rad, m].

        Raises:
            StateError: `q` does not have n finite entries.
        """
        q = self.checked_posture(q)
        links, n = len(self.capsules), self.n
        arm = Kinematics(
            q, np.empty((6, n)), np.empty(3), np.empty((3, 3)), np.empty((6, n)),
            np.empty((self.m, n)), np.empty((links, 3)), np.empty((links, 3)))
        fill(*self.joints(q), self.chain, *arm[1:])
        return arm

    def joints(self, q: Array) -> tuple[Array, Array, Array]:
        """Return Pinocchio's joint screws, rotations and positions, see `fill`.

        They are views into its memory, good until the next posture (n,), which is not checked.
        """
        pin.computeJointJacobians(self._model, self._data, q)
        return self._joints

    def kinematics_along(self, postures: Array) -> Kinematics:
        """Return the kinematics at every one of N postures (N, n): N leads every array."""
        count, links, n = len(postures), len(self.capsules), self.n
        arms = Kinematics(
            postures, np.empty((count, 6, n)), np.empty((count, 3)), np.empty((count, 3, 3)),
            np.empty((count, 6, n)), np.empty((count, self.m, n)), np.empty((count, links, 3)),
            np.empty((count, links, 3)))
        screws = np.empty((count, n, 6))
        turns, places = np.empty((count, n + 1, 3, 3)), np.empty((count, n + 1, 3))
        for i in range(count):
            screws[i], turns[i], places[i] = self.joints(postures[i])
        _fill_along(screws, turns, places, self.chain, *arms[1:])
        return arms

    def joint_points(self, q: npt.ArrayLike) -> Array:
        """Return the joint origins, then the tip, (n + 1, 3): the X_i of Eq. 7 [m].

        Raises:
            StateError: `q` does not have n finite entries.
        """
        pin.forwardKinematics(self._model, self._data, self.checked_posture(q))
        tip = pin.updateFramePlacement(self._model, self._data, self._tip_id)
        joints = [self._data.oMi[i].translation for i in range(1, self.n + 1)]
        return np.array([*joints, tip.translation])

    def checked_posture(self, q: npt.ArrayLike) -> Array:
        """Return `q` as a fresh (n,) array of floats.

        Raises:
            StateError: the length is wrong or an entry is not finite.
        """
        posture = np.array(q, dtype=float)
        if posture.shape == (self.n,) and math.isfinite(sum(posture.tolist())):
            return posture
        if posture.shape != (self.n,):
            raise StateError(
                f'posture has shape {posture.shape}; the chain has {self.n} joints: '
                f'{known(self.joint_names)}')
        if not np.isfinite(posture).all():
            name = self.joint_names[int(np.argmin(np.isfinite(posture)))]
            raise StateError(f"posture of joint '{name}' is not a finite number")
        return posture

    def task_rows(self, twist: npt.ArrayLike) -> Array:
        """Return the controlled entries (m,) of a full twist (6,)."""
        return np.asarray(twist, dtype=float)[self.rows]

    def full_twist(self, task: Array) -> Array:
        """Return the twist (6,) whose controlled entries are `task` (m,), zero elsewhere."""
        twist = np.zeros(6)
        twist[self.rows] = task
        return twist

    def _limits(self, what: str, values: Sequence[float] | float) -> Array:
        limits = floats_of(values)
        if limits.ndim > 1 or limits.size not in (1, self.n):
            raise RobotError(
                f'{what} has {limits.size} values; it takes 1 or {self.n}, one per joint: '
                f'{known(self.joint_names)}')
        limits = np.broadcast_to(limits.reshape(-1), (self.n,)).copy()
        for name, limit in zip(self.joint_names, limits):
            if not _SLOWEST <= limit <= _FASTEST:
                raise RobotError(
                    f"{what} of joint '{name}' is {limit}; it must lie in [{_SLOWEST:g}, "
                    f'{_FASTEST:g}] (give it as a parameter where the URDF has none)')
        return _read_only(limits)

    def _default_capsules(self, radius: float | None) -> list[Capsule]:
        """Straight capsules between consecutive joint origins, the last one to the tip.

        Joints that share an origin have no link between them and get none without a radius.
        """
        if radius is None:
            raise RobotError("the links have no shapes: give 'capsules', or 'link_radius' for "
                             'straight ones [m], 0 for bare lines')
        tip = self._model.frames[self._tip_id]
        ends = [self._model.jointPlacements[i + 1].translation for i in range(1, self.n)]
        ends.append(tip.placement.translation)
        return [Capsule(f'{name}_link', name, np.zeros(3), np.array(end), radius)
                for name, end in zip(self.joint_names, ends)
                if radius > 0.0 or np.any(end != 0.0)]

    def _place_capsules(self) -> None:
        """Express the capsules in their parent joints' frames."""
        joints, ends = [], []
        for capsule in self.capsules:
            if not self._model.existFrame(capsule.frame):
                raise RobotError(
                    f"capsule '{capsule.name}': the robot has no frame '{capsule.frame}'; "
                    f'it has {known(_links(self._model))}')
            frame = self._model.frames[_link_id(self._model, capsule.frame)]
            joints.append(frame.parentJoint)
            ends.append(np.column_stack(
                [frame.placement.act(np.array(end)) for end in (capsule.start, capsule.end)]))
        self._capsule_joint = np.array(joints, dtype=np.intp)
        self._capsule_ends = np.array(ends).reshape(-1, 3, 2)
        self.moves = _read_only(
            (np.arange(self.n) < self._capsule_joint[:, None]).astype(float))

    def _levers(self) -> Array:
        """Bound the distance of any capsule point from each joint by the lengths after it."""
        revolute = np.array([joint.shortname().startswith('JointModelR')
                             for joint in list(self._model.joints)[1:]])
        stroke = np.where(revolute, 0.0, np.maximum(
            np.abs(self._model.lowerPositionLimit), np.abs(self._model.upperPositionLimit)))
        length = np.array([float(np.linalg.norm(self._model.jointPlacements[i + 1].translation))
                           for i in range(self.n)])
        farthest = np.zeros(self.n + 1)
        for joint, ends in zip(self._capsule_joint, self._capsule_ends):
            farthest[joint] = max(farthest[joint], np.linalg.norm(ends, axis=0).max())
        levers = np.empty(self.n)
        beyond = 0.0
        for i in reversed(range(self.n)):
            beyond = max(float(farthest[i + 1]), beyond)
            levers[i] = beyond if revolute[i] else 1.0
            beyond += length[i] + stroke[i]
        return _read_only(levers * self.moves)

    def _self_pairs(self) -> npt.NDArray[np.intp]:
        """Pair the capsules that can run into each other, judged by random postures.

        Left out are those on the same link or on neighbouring ones, which touch at their joint;
        those that overlap at many postures, whose shapes do so by construction; and those two
        joints apart that never come near each other.
        """
        links = np.column_stack(np.triu_indices(len(self.capsules), 1))
        if not len(links):
            return links
        between = np.abs(np.diff(self._capsule_joint[links], axis=1))[:, 0]
        radii = np.array([c.radius for c in self.capsules])
        low = np.where(np.isfinite(self.position_min), self.position_min, -np.pi)
        high = np.where(np.isfinite(self.position_max), self.position_max, np.pi)
        random = np.random.default_rng(0)
        distances = []
        for _ in range(_PAIR_SAMPLES if (between > 1).any() else 0):
            arm = self.kinematics(random.uniform(low, high))
            distances.append(link_distances(
                arm.segment_start, arm.segment_end, radii, links).distance)
        sampled = np.array(distances).reshape(-1, len(links))
        touching = (sampled < 0.0).sum(axis=0) > _TOUCH_SHARE * _PAIR_SAMPLES
        never = (between == 2) & (sampled > _NEVER_NEAR).all(axis=0)
        keep = (between > 1) & ~touching & ~never
        return links[keep]


class Chain(NamedTuple):
    """What stays the same at every posture.

    Attributes:
        tip_joint: number of the joint that carries the tip frame.
        tip_in_joint: (3, 3) the tip's axes in that joint's frame.
        tip_from_joint: (3,) its origin there [m].
        capsule_joint: (c,) the joints that carry the capsules.
        capsule_ends: (c, 3, 2) in their frames [m].
        rows: (m,) the controlled ones of the six axes.
        in_tool: whether J is wanted in tool axes.
    """

    tip_joint: int
    tip_in_joint: Matrix
    tip_from_joint: Vector
    capsule_joint: Indices
    capsule_ends: Stack
    rows: Indices
    in_tool: bool


@compiled
def fill(
    screws: Matrix, rotations: Stack, positions: Matrix, chain: Fields[Chain],
    columns: OutMatrix, position: OutVector, rotation: OutMatrix, tip_jacobian: OutMatrix,
    jacobian: OutMatrix, start: OutMatrix, end: OutMatrix,
) -> None:
    """Write the fields of `Kinematics` from `columns` on.

    Args:
        screws: (n, 6) joint screws [v; w] at the base origin.
        rotations: (n + 1, 3, 3) of all joints, the base first.
        positions: (n + 1, 3) [m].
        chain: `Robot.chain`.
        columns, position, rotation, tip_jacobian, jacobian, start, end: see `Kinematics`.
    """
    tip_joint, tip_in_joint, tip_from_joint, capsule_joint, capsule_ends, rows, in_tool = chain
    for axis in range(3):
        position[axis] = positions[tip_joint, axis]
        for k in range(3):
            position[axis] += rotations[tip_joint, axis, k] * tip_from_joint[k]
            rotation[axis, k] = 0.0
            for other in range(3):
                rotation[axis, k] += (
                    rotations[tip_joint, axis, other] * tip_in_joint[other, k])
    x, y, z = position
    for j in range(len(screws)):
        v1, v2, v3, w1, w2, w3 = screws[j]
        columns[:, j] = screws[j]
        # v = v₀ + w × x at the tip point x.
        tip_jacobian[0, j] = v1 + w2 * z - w3 * y
        tip_jacobian[1, j] = v2 + w3 * x - w1 * z
        tip_jacobian[2, j] = v3 + w1 * y - w2 * x
        tip_jacobian[3:, j] = screws[j, 3:]
        for i in range(len(rows)):
            jacobian[i, j] = tip_jacobian[rows[i], j]
            if in_tool:
                part, axis = 3 * (rows[i] // 3), rows[i] % 3
                jacobian[i, j] = 0.0
                for k in range(3):
                    jacobian[i, j] += rotation[k, axis] * tip_jacobian[part + k, j]
    for capsule in range(len(capsule_joint)):
        joint = capsule_joint[capsule]
        for axis in range(3):
            start[capsule, axis] = end[capsule, axis] = positions[joint, axis]
            for k in range(3):
                start[capsule, axis] += rotations[joint, axis, k] * capsule_ends[capsule, k, 0]
                end[capsule, axis] += rotations[joint, axis, k] * capsule_ends[capsule, k, 1]


@compiled
def _fill_along(
    screws: Stack, rotations: Stacks, positions: Stack, chain: Fields[Chain],
    columns: OutStack, position: OutMatrix, rotation: OutStack, tip_jacobian: OutStack,
    jacobian: OutStack, start: OutStack, end: OutStack,
) -> None:
    """Do what `fill` does at each of N postures."""
    for i in range(len(screws)):
        fill(screws[i], rotations[i], positions[i], chain, columns[i], position[i], rotation[i],
             tip_jacobian[i], jacobian[i], start[i], end[i])


def _placements(data: pin.Data) -> tuple[Array, Array]:
    """Return rotations (n + 1, 3, 3) and positions (n + 1, 3) of all joints, of any posture.

    They are views into Pinocchio's own memory, where the placements lie one after another:
    they show the latest posture, without a Python call per joint, and live as long as `data`.
    """
    views = []
    for part in ('rotation', 'translation'):
        first, second = (getattr(data.oMi[i], part) for i in (0, 1))
        stride = second.ctypes.data - first.ctypes.data
        views.append(np.lib.stride_tricks.as_strided(
            first, (len(data.oMi), *first.shape), (stride, *first.strides), writeable=False))
    return views[0], views[1]


def _read_only(array: Array) -> Array:
    array.setflags(write=False)
    return array


def _links(model: pin.Model) -> list[str]:
    return [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]


def _link_id(model: pin.Model, link: str) -> int:
    """Return the frame of a link, which a joint may share its name with, or else any frame."""
    if model.existFrame(link, pin.FrameType.BODY):
        return int(model.getFrameId(link, pin.FrameType.BODY))
    return int(model.getFrameId(link))


def _chain(
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


def _ranges(chain: Sequence[Joint]) -> list[tuple[float, float]]:
    """Return the position limits of the chain's joints, infinite for continuous ones."""
    for joint in chain:
        if joint.kind == 'continuous':
            continue
        if max(abs(joint.lower), abs(joint.upper)) > LARGEST:
            raise RobotError(
                f"joint '{joint.name}' has the limits {joint.lower} and {joint.upper}; they must "
                f'lie within ±{LARGEST:g} (a joint that turns without end is continuous)')
        if joint.lower == joint.upper:
            raise RobotError(f"joint '{joint.name}' cannot move: lower and upper of its limit are "
                             f'{joint.lower}; correct them or lock it')
    return [(joint.lower, joint.upper) for joint in chain]


def _model_of_chain(
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
    world_in_base = data.oMf[_link_id(reduced, base_frame)].inverse()
    for i in range(1, reduced.njoints):
        if reduced.parents[i] == 0:
            reduced.jointPlacements[i] = world_in_base * reduced.jointPlacements[i]
    for frame in reduced.frames:
        if frame.parentJoint == 0:
            frame.placement = world_in_base * frame.placement
    return reduced


def _checked_axes(axes: Sequence[str]) -> tuple[str, ...]:
    unknown = [axis for axis in axes if axis not in AXES]
    if unknown or not axes or len(set(axes)) != len(axes):
        raise RobotError(
            f'axes are {list(axes)}; they must be a non-empty choice, without repetition, '
            f'of {known(AXES)}')
    return tuple(axis for axis in AXES if axis in axes)

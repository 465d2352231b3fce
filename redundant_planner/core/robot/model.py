"""An arm, or a body with several: its joints, their limits, and the frames and shapes of links."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
import copy
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.errors import known, RobotError, StateError
from redundant_planner.core.machine_code.packed import Packed
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import AXES, COMMAND_FRAMES
from redundant_planner.core.robot import capsules as shapes
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.chain import chain_of
from redundant_planner.core.robot.joint_limits import (
    checked_weights,
    joint_limits,
    position_ranges,
    Ranges,
    Values,
)
from redundant_planner.core.robot.kinematics import (
    fill_kinematics,
    Kinematics,
    kinematics_along,
    KinematicsAlong,
    Links,
    new_kinematics,
)
from redundant_planner.core.robot.payload import payload_capsules
from redundant_planner.core.robot.pinocchio_model import (
    link_id,
    link_names,
    links_on,
    model_of_chain,
    tree_joints,
)
from redundant_planner.core.robot.tips import Axes, checked_axes, checked_tips, controlled_rows
from redundant_planner.core.robot.urdf import read_urdf

Array = npt.NDArray[np.float64]
Arm = TypeVar('Arm', bound='Robot')
Number = TypeVar('Number', bound=np.generic)

# A posture further away is none: a continuous joint that turns at 10 rad/s gets there in a day.
_FARTHEST = 1e6


class Robot:
    """A chain of n joints from a base frame to a tip frame, or a tree of them to several.

    Attributes:
        name: the URDF's robot name.
        urdf: the URDF text it was built from.
        base_frame, tip_frame: frame names; the latter of the first tip.
        tips: frame names of all t tips.
        joint_names: the n joints, each after the one that carries it.
        axes: the controlled axes of the first tip, a subset of `AXES` in that order.
        command_frame: 'base' or 'tool': the frame in which a twist, and so J, is expressed.
        in_tool: whether that is the tool frame.
        rows: (m,) which of the six axes of each tip are controlled: 6 · tip + axis.
        position_min, position_max: (n,) [rad, m], infinite for continuous joints.
        velocity_max, acceleration_max, jerk_max: (n,) [rad/s, m/s; per s²; per s³], the last may
            be infinite.
        limit_sources: where each of these limits is from.
        weights: (n,) how unwilling the joints are to move.
        held: what the hand holds, in the tip's frame.
        capsules: the link shapes, then those of what the hand holds.
        self_pairs: (p, 2) indices of the capsules that can run into each other.
        moved: (c,) whether any joint moves a capsule. The others, of a base, keep links away from
            it, and obstacles may touch them.
        supports: (c, n) 1 where a joint moves a capsule, else 0.
        lever_arm_bounds: (c, n) the fastest any point of a capsule moves per unit of joint
            velocity, at any posture: a bound [m/rad, 1 for prismatic joints].
        chain: what kinematics are computed from.
    """

    def __init__(
        self,
        urdf: str,
        tip_frame: str = '',
        *,
        tips: Sequence[str] = (),
        base_frame: str = '',
        locked_positions: Mapping[str, float] | None = None,
        axes: Axes = AXES,
        command_frame: str = 'base',
        position_limits: Ranges | None = None,
        velocity_max: Values | None = None,
        acceleration_max: Values | None = None,
        jerk_max: Values | None = None,
        weights: Values | None = None,
        capsules: Sequence[Capsule] | None = None,
        link_radius: float | None = None,
    ) -> None:
        """Read the chain from a URDF.

        Args:
            urdf: the URDF's text (not its path).
            tip_frame: the link whose origin is the end effector.
            tips: such links of a body with several arms, instead of `tip_frame`.
            base_frame: the link that commands, obstacles and poses refer to; the root link
                if empty.
            locked_positions: joint name → position at which it is held [rad, m]. Joints
                outside the chain are held at 0 (or the nearest limit) unless given here.
                A chain joint named here is taken out of the chain.
            axes: controlled axes, out of `AXES`; tip → axes where tips differ.
            command_frame: 'base' or 'tool', see the class.
            position_limits: joint name → its lowest and highest position [rad, m], within the
                URDF's. An arm found outside may stay there or come in.
            velocity_max: replaces the URDF's velocity limits, one value or n [rad/s, m/s].
            acceleration_max: replaces the URDF's, one value or n [rad/s², m/s²]; 5 where neither
                gives one.
            jerk_max: replaces the URDF's, one value or n [rad/s³, m/s³]; infinite for none. 100/s
                times the acceleration limit where neither gives one.
            weights: how unwilling the joints are to move, one value or n; 1 if None. The
                parameter criteria.joint_weights replaces them.
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
        self.tips = checked_tips(tip_frame, tips)
        self.tip_frame = self.tips[0]
        chain = tree_joints(described, self.base_frame, self.tips, locked_positions or {})
        self._model = model_of_chain(
            described, chain, self.base_frame, locked_positions or {})
        self._data = self._model.createData()
        self._links: dict[str, tuple[int, Array]] = {}  # frame, and which joints move it
        self.joint_names: tuple[str, ...] = tuple(self._model.names)[1:]
        chain.sort(key=lambda joint: self.joint_names.index(joint.name))
        axes_of_tips = checked_axes(axes, self.tips)
        self.axes = axes_of_tips[0]
        self.rows = controlled_rows(axes_of_tips)
        if command_frame not in COMMAND_FRAMES:
            raise RobotError(
                f"command_frame is '{command_frame}'; it must be one of {known(COMMAND_FRAMES)}")
        self.command_frame = command_frame
        self.in_tool = command_frame == 'tool'
        (self.position_min, self.position_max, self.velocity_max, self.acceleration_max,
         self.jerk_max, self.limit_sources) = joint_limits(
            chain, positions=position_limits, velocity_max=velocity_max,
            acceleration_max=acceleration_max, jerk_max=jerk_max)
        self.weights = checked_weights(1.0 if weights is None else weights, self.joint_names)
        # Narrower limits change nothing about which links can meet: the arm may start beyond.
        self._reachable = position_ranges(chain)

        self._tip_ids = [link_id(self._model, tip) for tip in self.tips]
        own = tuple(
            shapes.straight_capsules(self._model, self._tip_ids, link_radius)
            if capsules is None else capsules)
        self.held: tuple[Obstacle, ...] = ()
        self._take_shapes(own, len(own))
        self.self_pairs = shapes.colliding_pairs(
            self.capsules, self.chain.capsule_joint, self.chain.parents, self._random_arms())

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def m(self) -> int:
        """Number of controlled axes, of all tips together."""
        return len(self.rows)

    def holding(self: Arm, things: Iterable[Obstacle], *, by_all: bool = False) -> Arm:
        """Return the same arm with other things in its hand, as more capsules on the tip's joint.

        Args:
            things: their shapes in the tip's frame; none for an empty hand.
            by_all: whether all tips hold them, which may touch them then, or the first one.

        Raises:
            ObstacleError: they cannot be held.
        """
        own, robot = self.capsules[:self._own], copy.copy(self)
        robot.held = tuple(things)
        held = payload_capsules(robot.held, self.tip_frame)
        robot._take_shapes((*own, *held), len(own))
        pairs = [self.self_pairs[(self.self_pairs < len(own)).all(axis=1)]]
        if held:
            hands = [self._model.frames[tip].parentJoint for tip in self._tip_ids]
            pairs.append(shapes.pairs_of_payload(
                robot.capsules, len(own), robot.chain.capsule_joint,
                hands if by_all else hands[:1], robot._random_arms()))
        robot.self_pairs = np.concatenate(pairs)
        return robot

    @property
    def moving_links(self) -> dict[str, str]:
        """The links that chain joints move → the joint that carries each."""
        model = self._model
        return {frame.name: model.names[frame.parentJoint] for frame in model.frames
                if frame.type == pin.FrameType.BODY and frame.parentJoint > 0}

    @property
    def links_at_rest(self) -> tuple[str, ...]:
        """The links that no chain joint moves."""
        return links_on(self._model, 0)

    @property
    def links_of_tip(self) -> tuple[str, ...]:
        """The links that move along with the tip, itself among them."""
        return links_on(self._model, self._model.frames[self._tip_ids[0]].parentJoint)

    def in_link(self, target: str, source: str, points: Array) -> Array:
        """Return points (k, 3) given in one link's frame in another's on the same joint [m]."""
        model = self._model
        there, here = (model.frames[link_id(model, i)].placement for i in (target, source))
        change = there.inverse() * here
        return points @ change.rotation.T + change.translation

    def in_base(self, q: npt.ArrayLike, link: str, points: Array) -> Array:
        """Return points (k, 3) given in a moving link's frame in the base frame [m].

        Raises:
            StateError: `q` does not have n finite entries.
        """
        pin.forwardKinematics(self._model, self._data, self.checked_posture(q))
        pose = pin.updateFramePlacement(self._model, self._data, link_id(self._model, link))
        return points @ pose.rotation.T + pose.translation

    def point(
        self, arm: Kinematics, link: str, offset: npt.ArrayLike = (0.0, 0.0, 0.0),
    ) -> tuple[Array, Array]:
        """Return where a point of a link is, and how the joints move it.

        Args:
            arm: the arm at a posture, from `kinematics`.
            link: the link's name.
            offset: (3,) the point in the link's frame [m].

        Returns:
            Its position (3,) in the base frame [m], and the Jacobian of that (3, n).

        Raises:
            RobotError: there is no such link.
        """
        pose, moving = self._pose_of(arm, link)
        position = pose.rotation @ np.asarray(offset, dtype=float) + pose.translation
        return position, moving * (  # v₀ + w × x
            arm.joint_screws[:3] + pin.skew(position).T @ arm.joint_screws[3:])

    def direction(
        self, arm: Kinematics, link: str, axis: npt.ArrayLike,
    ) -> tuple[Array, Array]:
        """Return where an axis of a link points, and how the joints turn it.

        Args:
            arm: the arm at a posture, from `kinematics`.
            link: the link's name.
            axis: (3,) in the link's frame, of any length but 0.

        Returns:
            A unit vector (3,) in the base frame, and the Jacobian of that (3, n) [1/rad].

        Raises:
            RobotError: there is no such link.
        """
        pose, moving = self._pose_of(arm, link)
        along = pose.rotation @ np.asarray(axis, dtype=float)
        along /= np.linalg.norm(along)
        return along, moving * (pin.skew(along).T @ arm.joint_screws[3:])  # w × x

    def _pose_of(self, arm: Kinematics, link: str) -> tuple[pin.SE3, Array]:
        """Return a link's pose in the base frame, and 1 for each joint (n,) that moves it."""
        known_link = self._links.get(link)
        if known_link is None:
            if not self._model.existFrame(link):
                raise RobotError(f"'{self.name}' has no link '{link}'; it has "
                                 f'{known(link_names(self._model))}')
            frame = link_id(self._model, link)
            joint = np.array([self._model.frames[frame].parentJoint], dtype=np.intp)
            known_link = self._links[link] = (
                frame, shapes.supports_of(joint, self.chain.parents)[0])
        frame, moving = known_link
        pin.forwardKinematics(self._model, self._data, arm.q)
        return pin.updateFramePlacement(self._model, self._data, frame), moving

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
        return self.kinematics_at(self.checked_posture(q))

    def kinematics_at(self, posture: Array) -> Kinematics:
        """Return the arm's kinematics at a checked posture (n,), which becomes part of them."""
        arm = Kinematics(posture, *map(np.empty, self._shapes))
        fill_kinematics(self._packed_chain, arm)
        return arm

    def kinematics_along(self, postures: Array) -> KinematicsAlong:
        """Return the kinematics at every one of N postures (N, n): N leads every array.

        Raises:
            StateError: the postures are not of n joints.
        """
        if postures.ndim != 2 or postures.shape[1] != self.n:
            raise StateError(
                f'postures have shape {postures.shape}; the chain takes (N, {self.n})')
        return kinematics_along(postures, self.chain)

    def links(self, arm: Kinematics) -> Links:
        """Return the links at a posture."""
        return Links(arm.segment_start, arm.segment_end, arm.joint_screws, self.chain.supports,
                     self.chain.parents)

    def joint_points(self, q: npt.ArrayLike) -> Array:
        """Return the joint origins, then the first tip, (n + 1, 3): the X_i of Eq. 7 [m].

        Raises:
            StateError: `q` does not have n finite entries.
        """
        pin.forwardKinematics(self._model, self._data, self.checked_posture(q))
        tip = pin.updateFramePlacement(self._model, self._data, self._tip_ids[0])
        joints = [self._data.oMi[i].translation for i in range(1, self.n + 1)]
        return np.array([*joints, tip.translation])

    def checked_posture(self, q: npt.ArrayLike) -> Array:
        """Return `q` as a fresh (n,) array of floats.

        Raises:
            StateError: the length is wrong, or an entry is not finite or absurdly large.
        """
        posture = np.array(q, dtype=float)
        if posture.shape == (self.n,) and sum(map(abs, posture.tolist())) <= _FARTHEST:  # no NaN
            return posture
        if posture.shape != (self.n,):
            raise StateError(
                f'posture has shape {posture.shape}; the chain has {self.n} joints: '
                f'{known(self.joint_names)}')
        if not np.isfinite(posture).all():
            name = self.joint_names[int(np.argmin(np.isfinite(posture)))]
            raise StateError(f"posture of joint '{name}' is not a finite number")
        j = int(np.abs(posture).argmax())
        raise StateError(f"posture of joint '{self.joint_names[j]}' is {posture[j]:g}; no joint "
                         f'is further from 0 than {_FARTHEST:g} [rad, m]')

    def task_rows(self, twist: npt.ArrayLike) -> Array:
        """Return the controlled entries (m,) of the tips' full twists (6 t,)."""
        return np.asarray(twist, dtype=float)[self.rows]

    def full_twist(self, task: Array) -> Array:
        """Return the twists (6 t,) whose controlled entries are `task` (m,), zero elsewhere."""
        twist = np.zeros(6 * len(self.tips))
        twist[self.rows] = task
        return twist

    def _take_shapes(self, capsules: tuple[Capsule, ...], own: int) -> None:
        """Set all that follows from the link shapes, of which the first ones are the arm's own."""
        self.capsules, self._own = capsules, own
        self.chain = chain_of(
            self._model, self._tip_ids, capsules, self.rows, in_tool=self.in_tool)
        self._packed_chain = Packed.of(self.chain)
        # Of the arrays that every posture gets anew, after the posture itself.
        self._shapes = [part.shape for part in new_kinematics(
            np.zeros(self.n), self.m, len(self.tips), len(self.capsules))[1:]]
        self.supports = _read_only(self.chain.supports.copy())
        self.moved = _read_only(self.chain.capsule_joint > 0)
        self.lever_arm_bounds = _read_only(shapes.lever_arm_bounds(
            self._model, self.chain.capsule_joint, self.chain.capsule_ends))

    def _random_arms(self) -> Iterator[Kinematics]:
        """Yield the kinematics at random postures within the URDF's limits, without end."""
        lowest, highest = self._reachable
        low = np.where(np.isfinite(lowest), lowest, -np.pi)
        high = np.where(np.isfinite(highest), highest, np.pi)
        random = np.random.default_rng(0)
        while True:
            yield self.kinematics(random.uniform(low, high))


def _read_only(array: npt.NDArray[Number]) -> npt.NDArray[Number]:
    array.setflags(write=False)
    return array

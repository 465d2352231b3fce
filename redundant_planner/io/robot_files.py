"""A robot from its URDF or parameter file: which chain, and which link shapes.

The same parameter file serves the nodes (`--params-file`) and everything offline.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any
import warnings

import numpy as np
import numpy.typing as npt

from redundant_planner.core.cache_folder import cache_folder
from redundant_planner.core.errors import known, ParameterError, PlannerError, shown
from redundant_planner.core.parameters import AXES
from redundant_planner.core.robot import model
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.possible_axes import is_overdetermined
from redundant_planner.core.robot.tips import Axes
from redundant_planner.core.target.start_posture import start_posture
from redundant_planner.io.collision_geometry import links_without_shape
from redundant_planner.io.link_shapes import capsule_entry, fitted_capsules, larger_than_the_rest
from redundant_planner.io.mobile_base import limits_with_base, ODOM, on_base
from redundant_planner.io.mount import base_of, mounted
from redundant_planner.io.parameter_files import (
    check_keys,
    entries_of,
    read_robot_parameters,
    RobotParameters,
    settings_of,
    urdf_folder,
    urdf_text,
)
from redundant_planner.io.resources import panda_urdf, resolve, share_directory
from redundant_planner.io.xacro_files import urdf_in


class Robot(model.Robot):
    """A robot arm, or several on one body: joints from base to tips, limits, and link shapes.

    Every link is a set of capsules. `from_urdf` fits them to the collision geometry; the planner
    keeps obstacles away from the capsules, so a link without one is unprotected.

    Attributes:
        name: the URDF's robot name.
        urdf: the URDF's text.
        base_frame: the link that twists, obstacles and poses refer to.
        tip_frame: the link whose origin is the end effector, the first of `tips`.
        tips: all t of them.
        joint_names: the n joints, each after the one that carries it.
        axes: the controlled axes of the first tip, out of vx, vy, vz, wx, wy, wz.
        command_frame: 'base' or 'tool', the axes in which a twist is expressed.
        position_min: (n,) [rad, m], infinite for continuous joints.
        position_max: (n,) [rad, m], likewise.
        velocity_max: (n,) [rad/s, m/s].
        acceleration_max, jerk_max: (n,) [rad/s², m/s²; per s³].
        limit_sources: where each limit is from: the URDF, a parameter, or a default.
        capsules: the link shapes.
    """

    @classmethod
    def from_urdf(
        cls, path: str | Path, tip_frame: str = '', *,
        tips: Sequence[str] = (),
        base_frame: str = '',
        locked_positions: Mapping[str, float] | None = None,
        axes: Axes = AXES,
        command_frame: str = 'base',
        position_limits: Mapping[str, tuple[float, float]] | None = None,
        velocity_max: Sequence[float] | float | None = None,
        acceleration_max: Sequence[float] | float | None = None,
        jerk_max: Sequence[float] | float | None = None,
        weights: Sequence[float] | float | None = None,
        capsules: Sequence[Capsule] | None = None,
        link_radius: float | None = None,
    ) -> Robot:
        """Return the arm of a URDF file, with capsules fitted to its collision geometry.

        The first fit of an arm takes some seconds; the result is kept in the user's cache folder.
        A link that can be seen but has no collision geometry is named in a warning.

        Args:
            path: a file, or a `file://` or `package://` location; xacro files are expanded where
                xacro is installed. Its meshes may be relative to it, or in a package that it lies
                in or that is installed.
            tip_frame: the link whose origin is the end effector.
            tips: such links of a body with several arms, instead of `tip_frame`.
            base_frame: the link that twists, obstacles and poses refer to; empty for the root.
            locked_positions: joint name → position at which it is held [rad, m]. Other joints
                outside the chain are held at 0, or at the limit nearest to it.
            axes: the controlled axes, or tip → axes; the null space may use the others.
            command_frame: 'base' or 'tool', the axes in which a twist is expressed.
            position_limits: joint name → its lowest and highest position [rad, m], where the
                drives' are narrower than the URDF's.
            velocity_max: replaces the URDF's limits, one value or n [rad/s, m/s].
            acceleration_max: one value or n [rad/s², m/s²]; None for the URDF's, or 5 where it
                has none. Ask the maker.
            jerk_max: one value or n [rad/s³, m/s³]; None for the URDF's, or 100/s times the
                acceleration limit where it has none; infinite for no limit.
            weights: how unwilling the joints are to move, one value or n; 1 if None.
            capsules: these link shapes instead of fitted ones.
            link_radius: straight capsules of this radius from joint to joint instead of fitted
                ones [m]; 0 for bare lines.

        Raises:
            PlannerError: there is no such file.
            RobotError: the URDF is malformed, a name is unknown, the frames make no chain, a
                limit makes no sense, or there is no collision geometry to fit capsules to.
        """
        file = resolve(str(path))
        urdf = urdf_in(file)

        def robot_with(shapes: Sequence[Capsule] | None) -> Robot:
            return cls(
                urdf, tip_frame, tips=tips, base_frame=base_frame,
                locked_positions=locked_positions, axes=axes, command_frame=command_frame,
                position_limits=position_limits, velocity_max=velocity_max,
                acceleration_max=acceleration_max, jerk_max=jerk_max, weights=weights,
                capsules=shapes, link_radius=link_radius)

        if capsules is not None or link_radius is not None:
            return robot_with(capsules)
        return _looked_at(
            robot_with(_fitted(robot_with([]), file.parent, locked_positions or {},
                               warnings.warn)), warnings.warn)

    @classmethod
    def from_file(cls, path: str | Path, **changes: Any) -> Robot:
        """Return the arm of a robot parameter file, as the nodes take it.

        Args:
            path: a file, or a `file://` or `package://` location, that starts with
                `/**: ros__parameters:`; or the name of one in `config/robots`, such as 'panda'.
            changes: robot parameters that replace those of the file, such as `axes` or `urdf`.

        Raises:
            ParameterError: the file is not a parameter file, or a value does not fit.
            PlannerError: there is no such file, or it does not describe a robot.
        """
        folder = share_directory() / 'config' / 'robots'
        shipped = {file.stem: file for file in folder.glob('*.yaml')}
        if str(path) not in shipped:
            if str(path).isidentifier() and not Path(path).exists():
                raise PlannerError(f'{shown(str(path))} is neither a file nor a robot that comes '
                                   f'with this package: {known(shipped)}')
            return _robot_of_file(resolve(str(path)), changes, warnings.warn)
        if path == 'panda' and 'urdf' not in changes:
            changes['urdf'] = str(_panda())
        return _robot_of_file(shipped[str(path)], changes, warnings.warn)

    @cached_property
    def ready(self) -> npt.NDArray[np.float64]:
        """A posture (n,) to start from: away from limits, singularities and its own links."""
        return start_posture(self)


def _panda() -> Path:
    """Return where a Panda's URDF is.

    Raises:
        PlannerError: nowhere; the message says what to install.
    """
    found = panda_urdf()
    if found is None:
        raise PlannerError("'panda' needs a URDF: install ros-jazzy-moveit-resources-panda-"
                           'description, or pip install example-robot-data')
    return found


def build_robot(
    parameters: RobotParameters, urdf: str, capsules: Mapping[str, Mapping[str, Any]], *,
    folder: Path | None = None, say: Callable[[str], object] | None = None,
    warn: Callable[[str], object] | None = None,
) -> Robot:
    """Return the robot that parameters, URDF text and capsule entries describe.

    Args:
        parameters: from a node or a file.
        urdf: the URDF's text.
        capsules: name → {frame, start, end, radius}.
        folder: that a relative `parameters.urdf` refers to.
        say: takes a sentence before something that lasts some seconds.
        warn: takes a sentence about links that nothing protects, or that are suspiciously large.

    Raises:
        RobotError, ObstacleError, ParameterError: with what is wrong.
    """
    p = parameters
    if not (p.tip_frame or p.tips):
        raise ParameterError("parameter 'tip_frame' is empty; name the URDF link that is the "
                             "end effector, or several with 'tips'")
    urdf = on_base(mounted(urdf, p.mount_frame, p.mount_pose), p)
    base_frame = ODOM if p.base else base_of(urdf, p.mount_frame, p.base_frame)

    def robot_with(
        shapes: Sequence[Capsule] | None, limits: Mapping[str, tuple[float, ...]],
    ) -> Robot:
        return Robot(
            urdf, p.tip_frame, tips=p.tips, base_frame=base_frame, locked_positions=p.locked,
            axes=p.axes, command_frame=p.command_frame, position_limits=p.position_ranges,
            **{name: values or None for name, values in limits.items()},
            capsules=shapes, link_radius=p.link_radius)

    limits: Mapping[str, tuple[float, ...]] = {
        'velocity_max': p.velocity_max, 'acceleration_max': p.acceleration_max,
        'jerk_max': p.jerk_max}
    if p.base:
        # Without the limits given, as what is meant for the arm's joints is not for the base's.
        limits = limits_with_base(limits, p, robot_with([], {'velocity_max': (1.0,)}).n)
    if p.capsules:
        shapes = [_capsule(name, capsules.get(name, {})) for name in p.capsules]
        return _looked_at(robot_with(shapes, limits), warn)
    if p.link_shapes == 'straight':
        return _looked_at(robot_with(None, limits), warn)
    bare = robot_with([], limits)
    if say is not None:
        kept = ('once for all starts to come' if cache_folder() is not None else
                'at every start: there is no cache folder that nobody else can write to')
        say(f"fitting capsules to the URDF's collision geometry, {kept}")
    shapes = _fitted(bare, urdf_folder(p, folder), p.locked, warn)
    return _looked_at(robot_with(shapes, limits), warn)


def _looked_at(arm: Robot, warn: Callable[[str], object] | None) -> Robot:
    """Return an arm after a word about what is suspicious: large link shapes, too many axes."""
    if warn is not None:
        for sentence in larger_than_the_rest(arm):
            warn(sentence)
        if is_overdetermined(arm):
            warn(f"these {arm.n} joints cannot follow every twist of {arm.m} axes, at any "
                 "posture, and the arm may not move at all: name fewer in 'axes'; show_robot "
                 'proposes some')
    return arm


def with_more_capsules(
    robot: model.Robot, parameters: RobotParameters, more: Mapping[str, Mapping[str, Any]],
) -> model.Robot:
    """Return a robot with further shapes, which may be of links that do not move.

    Args:
        robot: as it is.
        parameters: that it was built with.
        more: name → {frame, start, end, radius}.

    Raises:
        RobotError, ObstacleError, ParameterError: with what is wrong.
    """
    if not more:
        return robot
    entries = {f'link {i}': capsule_entry(c) for i, c in enumerate(robot.capsules)} | dict(more)
    return build_robot(replace(parameters, capsules=tuple(entries)), robot.urdf, entries)


def _fitted(
    bare: model.Robot, folder: Path | None, held: Mapping[str, float],
    warn: Callable[[str], object] | None,
) -> list[Capsule]:
    """Return capsules fitted to a robot without shapes, some joints of which are locked."""
    fits = fitted_capsules(bare, folder, held=held)
    if warn is not None:
        if unprotected := links_without_shape(bare):
            warn(f'no collision geometry, so nothing keeps obstacles away: {known(unprotected)}')
        if large := [link for fit in fits for link in fit.bare]:
            warn('links that stand still and that no capsule fits closely, so nothing keeps the '
                 f'arm off them: {known(large)}; give their shapes as obstacles, '
                 'docs/robots.md, Link shapes')
    return [capsule for fit in fits for capsule in fit.capsules]


def load_robot(path: Path, **changes: Any) -> Robot:
    """Return the robot of a ROS parameter file.

    Args:
        path: a file with `/**: ros__parameters:` at its top.
        changes: fields of RobotParameters that replace those of the file.

    Raises:
        PlannerError: the file is unusable, with what is wrong.
    """
    return _robot_of_file(path, changes, None)


def _robot_of_file(
    path: Path, changes: Mapping[str, Any], warn: Callable[[str], object] | None,
) -> Robot:
    parameters, capsules = read_robot_parameters(path)
    parameters = replace(parameters, **changes)
    urdf = urdf_text(parameters, path.parent)
    if not urdf:
        raise ParameterError(f"'{path}' gives no robot: set 'urdf'")
    return build_robot(parameters, urdf, capsules, folder=path.parent, warn=warn)


def robot_of_values(values: Mapping[str, Any]) -> Robot:
    """Return the robot of parameter values that hold its URDF (`parameter_file_text`).

    Raises:
        PlannerError: they do not make a robot.
    """
    parameters = settings_of(RobotParameters, values)
    return build_robot(parameters, urdf_text(parameters), entries_of(values, 'capsule'))


def _capsule(name: str, entry: Mapping[str, Any]) -> Capsule:
    check_keys(f"capsule '{name}'", entry, ('frame', 'start', 'end', 'radius'))
    return Capsule(name, str(entry['frame']), entry['start'], entry['end'], entry['radius'])

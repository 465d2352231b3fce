"""A robot as it stands in a parameter file: which URDF, which chain, which shapes.

The same file serves the nodes (`--params-file`) and everything offline.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar
import xml.etree.ElementTree as ElementTree

import numpy as np
import yaml

from redundant_planner.core.errors import known, ParameterError, RobotError
from redundant_planner.core.joint_motion import joint_ranges
from redundant_planner.core.obstacles import Obstacle
from redundant_planner.core.parameters import check, parameter
from redundant_planner.core.robot import AXES, Capsule, COMMAND_FRAMES, Robot
from redundant_planner.link_shapes import capsule_entry, fitted_capsules
from redundant_planner.resources import resolve

Settings = TypeVar('Settings')

# What forks after this many joints is a hand.
_ARM_JOINTS = 6


@dataclass(frozen=True)
class RobotParameters:
    """What the planner must know of an arm; fixed while a node runs.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    urdf: str = parameter(
        '', description='URDF file: a path, file:// or package:// location. Empty: the '
                        'parameter robot_description, or else the topic of that name.')
    robot_description: str = parameter(
        '', description="The URDF's text itself, used where urdf is empty.")
    base_frame: str = parameter(
        '', description='Link in whose frame commands and obstacles are given; empty for the '
                        "URDF's root link.")
    tip_frame: str = parameter(
        '', description='Link whose origin is the end effector. Required.')
    axes: tuple[str, ...] = parameter(
        AXES, choices=AXES,
        description='Axes of the twist that are controlled; the others are left to the null '
                    'space.')
    command_frame: str = parameter(
        'base', choices=COMMAND_FRAMES,
        description='Axes in which cmd_vel is expressed: base (fixed) or tool (turning with the '
                    'tip). The reference point is the tip either way.')
    locked_joints: tuple[str, ...] = parameter(
        (), description='Joints held still at locked_positions.')
    locked_positions: tuple[float, ...] = parameter(
        (), unit='rad, m', description='One position per locked joint.')
    lock_where_measured: bool = parameter(
        False, description='Whether planner_node holds the other joints outside the chain where '
                           'joint_states says that they are when it starts, rather than at 0: '
                           'grippers and second arms that nobody moves meanwhile.')
    velocity_max: tuple[float, ...] = parameter(
        (), low=1e-6, unit='rad/s, m/s',
        description="Replaces the URDF's velocity limits: one value, or one per joint.")
    acceleration_max: tuple[float, ...] = parameter(
        (5.0,), low=1e-6, unit='rad/s², m/s²',
        description='Largest joint acceleration: one value, or one per joint. Higher than the '
                    'drives can follow, and the arm overshoots limits and clearances.')
    link_shapes: str = parameter(
        'fitted', choices=('fitted', 'straight'),
        description="Where no capsules are listed: fitted around the URDF's collision geometry "
                    '(show_robot shows them), or straight from joint to joint with link_radius.')
    link_radius: float = parameter(
        0.0, low=0.0, high=1.0, unit='m',
        description='Radius of straight link shapes. Too small, and the arm touches what it '
                    'should not.')
    capsules: tuple[str, ...] = parameter(
        (), description='Names of the link shapes; each has the parameters '
                        'capsule.NAME.frame, .start, .end and .radius.')

    def __post_init__(self) -> None:
        """Check every value and the relations between them."""
        check(self)
        if len(self.locked_joints) != len(self.locked_positions):
            raise ParameterError(
                f"parameter 'locked_positions' has {len(self.locked_positions)} entries; it "
                f"takes {len(self.locked_joints)}, one per name in 'locked_joints'")


def urdf_text(parameters: RobotParameters, folder: Path | None = None) -> str:
    """Return the URDF that the parameters name or hold; empty if they do neither.

    Args:
        parameters: from a node or a file.
        folder: for a relative path; the working directory if None.

    Raises:
        PlannerError: there is no such file.
    """
    if parameters.urdf:
        return resolve(parameters.urdf, folder).read_text()
    return parameters.robot_description


def build_robot(
    parameters: RobotParameters, urdf: str, capsules: Mapping[str, Mapping[str, Any]], *,
    folder: Path | None = None, say: Callable[[str], object] | None = None,
) -> Robot:
    """Return the robot that parameters, URDF text and capsule entries describe.

    Args:
        parameters: from a node or a file.
        urdf: the URDF's text.
        capsules: name → {frame, start, end, radius}.
        folder: that a relative `parameters.urdf` refers to.
        say: takes a sentence before something that lasts some seconds.

    Raises:
        RobotError, ObstacleError, ParameterError: with what is wrong.
    """
    p = parameters
    if not p.tip_frame:
        raise ParameterError("parameter 'tip_frame' is empty; name the URDF link that is the "
                             'end effector')

    def robot_with(shapes: Sequence[Capsule] | None) -> Robot:
        return Robot(
            urdf, p.tip_frame, base_frame=p.base_frame,
            locked_positions=dict(zip(p.locked_joints, p.locked_positions)),
            axes=p.axes, command_frame=p.command_frame, velocity_max=p.velocity_max or None,
            acceleration_max=p.acceleration_max, capsules=shapes, link_radius=p.link_radius)

    if p.capsules:
        return robot_with([_capsule(name, capsules.get(name, {})) for name in p.capsules])
    if p.link_shapes == 'straight':
        return robot_with(None)
    if say is not None:
        say("fitting capsules to the URDF's collision geometry, once for all starts to come")
    fits = fitted_capsules(robot_with([]), urdf_folder(p, folder))
    return robot_with([capsule for fit in fits for capsule in fit.capsules])


def joints_to_measure(parameters: RobotParameters, urdf: str) -> tuple[str, ...]:
    """Return the joints that are locked where they are found; none if that is not wanted.

    Those are the movable joints of the URDF that are neither in the chain nor locked by name.

    Raises:
        RobotError, ParameterError: as `build_robot`.
    """
    if not parameters.lock_where_measured:
        return ()
    chain = build_robot(replace(parameters, capsules=(), link_shapes='straight'), urdf, {})
    return tuple(name for name in joint_ranges(urdf).names
                 if name not in chain.joint_names and name not in parameters.locked_joints)


def locked_at(parameters: RobotParameters, positions: Mapping[str, float]) -> RobotParameters:
    """Return the parameters with more joints locked: name → position [rad, m]."""
    return replace(
        parameters, locked_joints=(*parameters.locked_joints, *positions),
        locked_positions=(*parameters.locked_positions, *positions.values()))


def urdf_folder(parameters: RobotParameters, folder: Path | None = None) -> Path | None:
    """Return the folder of the URDF file, for meshes relative to it; None without a file."""
    return resolve(parameters.urdf, folder).parent if parameters.urdf else None


def load_robot(path: Path, **changes: Any) -> Robot:
    """Return the robot of a ROS parameter file.

    Args:
        path: a file with `/**: ros__parameters:` at its top.
        changes: fields of RobotParameters that replace those of the file.

    Raises:
        PlannerError: the file is unusable, with what is wrong.
    """
    parameters, capsules = read_robot_parameters(path)
    parameters = replace(parameters, **changes)
    urdf = urdf_text(parameters, path.parent)
    if not urdf:
        raise ParameterError(f"'{path}' gives no robot: set 'urdf'")
    return build_robot(parameters, urdf, capsules, folder=path.parent)


def read_robot_parameters(path: Path) -> tuple[RobotParameters, dict[str, dict[str, Any]]]:
    """Return a parameter file's robot parameters and capsule entries.

    Raises:
        ParameterError: the file is unusable, with what is wrong.
    """
    values = read_parameter_file(path)
    return settings_of(RobotParameters, values), values.get('capsule', {})


def settings_of(settings: type[Settings], values: Mapping[str, Any]) -> Settings:
    """Return a parameter dataclass with those of its fields that `values` has.

    Raises:
        ParameterError: a value does not fit.
    """
    names = {entry.name for entry in fields(settings)}  # type: ignore[arg-type]
    return settings(**{key: value for key, value in values.items() if key in names})


def robot_of_values(values: Mapping[str, Any]) -> Robot:
    """Return the robot of parameter values that hold its URDF (`parameter_file_text`).

    Raises:
        PlannerError: they do not make a robot.
    """
    parameters = settings_of(RobotParameters, values)
    return build_robot(parameters, urdf_text(parameters), values.get('capsule', {}))


def read_parameter_file(path: Path) -> dict[str, Any]:
    """Return the parameters that a ROS parameter file sets for every node.

    Raises:
        ParameterError: it is not YAML, or not a parameter file.
    """
    try:
        content = yaml.safe_load(path.read_text())
    except yaml.YAMLError as error:
        raise ParameterError(f"'{path}' is not valid YAML: {error}") from None
    return parameter_values(content, f"'{path}'")


def parameter_values(content: Any, what: str) -> dict[str, Any]:
    """Return what the content of a ROS parameter file sets for every node.

    Args:
        content: as YAML gives it.
        what: it is, for the message.

    Raises:
        ParameterError: it is not a parameter file.
    """
    try:
        return dict(content['/**']['ros__parameters'])
    except (TypeError, KeyError, ValueError):
        raise ParameterError(f"{what} is not a parameter file; it must start with '/**:' and "
                             "'ros__parameters:'") from None


def obstacle_of(name: str, entry: Mapping[str, Any]) -> Obstacle:
    """Return an obstacle from its entry in a parameter or scenario file.

    Raises:
        ObstacleError, ParameterError: with what is wrong.
    """
    _check_keys(f"obstacle '{name}'", entry, ('center', 'semi_axes'),
                ('orientation', 'velocity'))
    return Obstacle(name, **{key: np.asarray(value, dtype=float)
                             for key, value in entry.items() if key != 'name'})


def static_obstacles(values: Mapping[str, Any]) -> list[Obstacle]:
    """Return the static obstacles among parameter values.

    Raises:
        ObstacleError, ParameterError: with what is wrong.
    """
    return [obstacle_of(name, entry)
            for name, entry in (values.get('static_obstacle') or {}).items()]


def _capsule(name: str, entry: Mapping[str, Any]) -> Capsule:
    _check_keys(f"capsule '{name}'", entry, ('frame', 'start', 'end', 'radius'))
    return Capsule(name, str(entry['frame']), np.asarray(entry['start'], dtype=float),
                   np.asarray(entry['end'], dtype=float), float(entry['radius']))


def _check_keys(
    what: str, entry: Mapping[str, Any], required: tuple[str, ...],
    optional: tuple[str, ...] = (),
) -> None:
    missing = [key for key in required if key not in entry]
    unknown = [key for key in entry if key not in (*required, *optional, 'name')]
    if missing or unknown:
        raise ParameterError(
            f'{what} ' + (f'lacks {known(missing)}' if missing else f'has {known(unknown)}')
            + f'; it takes {known((*required, *optional))}')


def likely_tip(urdf: str) -> str:
    """Return the link that is probably the end effector.

    It lies at the end of the chain with the most movable joints, or before the hand: where,
    after six joints or more, several joints hang from one link or a joint mimics another.

    Raises:
        RobotError: the URDF does not describe a robot.
    """
    try:
        root = ElementTree.fromstring(urdf)
    except ElementTree.ParseError as error:
        raise RobotError(f'the URDF is not well-formed XML: {error}') from None
    children: dict[str, list[tuple[str, bool, bool]]] = {}
    hanging = set()
    for joint in root.findall('joint'):
        parent, child = (joint.find(end) for end in ('parent', 'child'))
        if parent is None or child is None:
            continue
        name = child.get('link', '')
        hanging.add(name)
        children.setdefault(parent.get('link', ''), []).append(
            (name, joint.get('type') != 'fixed', joint.find('mimic') is not None))
    roots = [link.get('name', '') for link in root.findall('link')
             if link.get('name') not in hanging]

    def longest(link: str, joints: int) -> tuple[int, str]:
        branches = children.get(link, [])
        moving = [branch for branch in branches if branch[1]]
        if joints >= _ARM_JOINTS and (len(moving) > 1 or any(mimic for *_, mimic in moving)):
            return joints, link
        best = joints, link
        for child, moves, mimic in branches:
            found = longest(child, joints + moves) if not mimic else best
            if found[0] > best[0] or (found[0] == best[0] and not moves):
                best = found
        return best

    if not roots:
        raise RobotError('the URDF has no root link')
    return longest(roots[0], 0)[1]


def parameter_file_text(
    parameters: RobotParameters, robot: Robot, static: Mapping[str, Mapping[str, Any]],
    *settings: Any,
) -> str:
    """Return a ROS parameter file that needs no other file: the URDF and all capsules are in it.

    Args:
        parameters: as the robot was built with.
        robot: the robot.
        static: entries of the static obstacles.
        settings: further parameter dataclasses.
    """
    values: dict[str, Any] = {}
    for group in (parameters, *settings):
        values |= {entry.name: getattr(group, entry.name) for entry in fields(group)}
    values |= {'urdf': '', 'robot_description': robot.urdf,
               'capsules': [c.name for c in robot.capsules],
               'capsule': {c.name: capsule_entry(c) for c in robot.capsules},
               'static_obstacle': {name: dict(entry) for name, entry in static.items()}}
    values = {key: list(value) if isinstance(value, tuple) else value
              for key, value in values.items()}
    # In C where there is such: the planner does this between two ticks.
    dumper = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)
    return str(yaml.dump({'/**': {'ros__parameters': values}}, Dumper=dumper, sort_keys=False))

"""A robot as it stands in a parameter file: which URDF, which chain, which shapes.

The same file serves the nodes (`--params-file`) and everything offline.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import yaml

from redundant_planner.core.cache_folder import cache_folder
from redundant_planner.core.errors import (
    known,
    ObstacleError,
    ParameterError,
    PlannerError,
    shown,
    unknown_names,
)
from redundant_planner.core.joint_motion import joint_ranges
from redundant_planner.core.obstacles import Obstacle
from redundant_planner.core.parameters import check, parameter, PlannerParameters
from redundant_planner.core.robot import AXES, Capsule, COMMAND_FRAMES, floats_of, Robot
from redundant_planner.core.urdf import Joint, read_urdf
from redundant_planner.link_shapes import capsule_entry, fitted_capsules, links_without_shape
from redundant_planner.node_parameters import (
    FakeHardwareParameters,
    PlannerNodeParameters,
    PlayerParameters,
)
from redundant_planner.resources import read_text, resolve, yaml_content

Settings = TypeVar('Settings')

# What a parameter file may hold besides the fields of the parameter dataclasses: named things, and
# what every ROS node takes.
_NAMED = ('capsule', 'static_obstacle')
_EVERY_NODES = ('use_sim_time', 'qos_overrides', 'start_type_description_service')

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
        (), low=-1e6, high=1e6, unit='rad, m', description='One position per locked joint.')
    lock_where_measured: bool = parameter(
        False, description='Whether planner_node holds the other joints outside the chain where '
                           'joint_states says that they are when it starts, rather than at 0: '
                           'grippers and second arms that nobody moves meanwhile.')
    velocity_max: tuple[float, ...] = parameter(
        (), low=1e-6, high=1e4, unit='rad/s, m/s',
        description="Replaces the URDF's velocity limits: one value, or one per joint.")
    acceleration_max: tuple[float, ...] = parameter(
        (5.0,), low=1e-6, high=1e6, unit='rad/s², m/s²',
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
        return read_text(resolve(parameters.urdf, folder))
    return parameters.robot_description


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
        warn: takes a sentence about links that nothing protects.

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
    bare = robot_with([])
    if say is not None:
        kept = ('once for all starts to come' if cache_folder() is not None else
                'at every start: there is no cache folder that nobody else can write to')
        say(f"fitting capsules to the URDF's collision geometry, {kept}")
    fits = fitted_capsules(bare, urdf_folder(p, folder))
    if warn is not None and (unprotected := links_without_shape(bare)):
        warn(f'no collision geometry, so nothing keeps obstacles away: {known(unprotected)}')
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


def read_robot_parameters(
    path: Path,
) -> tuple[RobotParameters, dict[str, Mapping[str, Any]]]:
    """Return a parameter file's robot parameters and capsule entries.

    Raises:
        ParameterError: the file is unusable, with what is wrong.
    """
    values = read_parameter_file(path)
    parameters, capsules = settings_of(RobotParameters, values), entries_of(values, 'capsule')
    unlisted = [name for name in capsules if name not in parameters.capsules]
    if unlisted:
        raise ParameterError(f"'{path}' describes the capsules {known(unlisted)}, which the "
                             "parameter 'capsules' does not name")
    return parameters, capsules


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
    return build_robot(parameters, urdf_text(parameters), entries_of(values, 'capsule'))


def read_parameter_file(path: Path) -> dict[str, Any]:
    """Return the parameters that a ROS parameter file sets for every node.

    Raises:
        ParameterError: it is not YAML, not a parameter file, or names a parameter that no node
            of this package has.
    """
    what = f"'{path}'"
    try:
        content = yaml_content(read_text(path), what)
    except PlannerError as error:
        raise ParameterError(str(error)) from None
    values = parameter_values(content, what)
    unknown = unknown_names(values, known_parameters())
    if unknown:
        raise ParameterError(f'{what}: ' + '; '.join(unknown))
    return values


def known_parameters() -> list[str]:
    """Return the names that a file for this package's nodes may set."""
    groups = (RobotParameters, PlannerParameters, PlannerNodeParameters, FakeHardwareParameters,
              PlayerParameters)
    return [*(entry.name for group in groups for entry in fields(group)), *_NAMED, *_EVERY_NODES]


def parameter_values(content: Any, what: str) -> dict[str, Any]:
    """Return what the content of a ROS parameter file sets for every node.

    Args:
        content: as YAML gives it.
        what: it is, for the message.

    Returns:
        name → value; names with dots are taken apart, as ROS does.

    Raises:
        ParameterError: it is not a parameter file.
    """
    section = content.get('/**') if isinstance(content, Mapping) else None
    given = section.get('ros__parameters') if isinstance(section, Mapping) else None
    if not isinstance(given, Mapping):
        raise ParameterError(f"{what} is not a parameter file; it must start with '/**:' and "
                             "'ros__parameters:'")
    values: dict[str, Any] = {}
    for name, value in given.items():
        *groups, last = str(name).split('.')
        place = values
        for group in groups:
            inner = place.get(group)
            place[group] = place = dict(inner) if isinstance(inner, Mapping) else {}
        place[last] = {**place[last], **value} if (
            isinstance(value, Mapping) and isinstance(place.get(last), Mapping)) else value
    return values


def entries_of(values: Mapping[str, Any], what: str) -> dict[str, Mapping[str, Any]]:
    """Return the named things among parameter values: name → key → value.

    Args:
        values: parameters.
        what: 'capsule' or 'static_obstacle'.

    Raises:
        ParameterError: there is something else in their place.
    """
    entries = values.get(what)
    if entries is None:
        return {}
    if not isinstance(entries, Mapping) or not all(
            isinstance(entry, Mapping) for entry in entries.values()):
        raise ParameterError(f"parameter '{what}' is {shown(entries)}; it must hold names, and "
                             f'under each the keys of that {what.replace("_", " ")}')
    return {str(name): entry for name, entry in entries.items()}


def obstacle_of(name: str, entry: Mapping[str, Any]) -> Obstacle:
    """Return an obstacle from its entry in a parameter or scenario file.

    Raises:
        ObstacleError, ParameterError: with what is wrong.
    """
    check_keys(f"obstacle '{name}'", entry, ('center', 'semi_axes'),
               ('orientation', 'velocity', 'name'))
    arrays = {}
    for key in entry:
        if key != 'name':
            arrays[key] = floats_of(entry[key])
            if arrays[key].ndim != 1:
                raise ObstacleError(f"obstacle '{name}': {key} is {shown(entry[key])}; it takes "
                                    'a list of numbers')
    return Obstacle(name, **arrays)


def static_obstacles(values: Mapping[str, Any]) -> list[Obstacle]:
    """Return the static obstacles among parameter values.

    Raises:
        ObstacleError, ParameterError: with what is wrong.
    """
    return [obstacle_of(name, entry)
            for name, entry in entries_of(values, 'static_obstacle').items()]


def _capsule(name: str, entry: Mapping[str, Any]) -> Capsule:
    check_keys(f"capsule '{name}'", entry, ('frame', 'start', 'end', 'radius'))
    return Capsule(name, str(entry['frame']), entry['start'], entry['end'], entry['radius'])


def check_keys(
    what: str, entry: Any, required: tuple[str, ...], optional: tuple[str, ...] = (),
) -> None:
    """Make sure that an entry of a file has its keys, and no others.

    Raises:
        ParameterError: it has not.
    """
    takes = f'it takes {known((*required, *optional))}'
    if not isinstance(entry, Mapping):
        raise ParameterError(f'{what} is {shown(entry)}; {takes}')
    missing = [key for key in required if key not in entry]
    unknown = [key for key in entry if key not in (*required, *optional)]
    if missing or unknown:
        raise ParameterError(
            f'{what} ' + (f'lacks {known(missing)}' if missing else f'has {known(unknown)}')
            + f'; {takes}')


def likely_tip(urdf: str) -> str:
    """Return the link that is probably the end effector.

    It lies at the end of the chain with the most movable joints, or before the hand: where,
    after six joints or more, several joints hang from one link or a joint mimics another.

    Raises:
        RobotError: the URDF does not describe a robot.
    """
    described = read_urdf(urdf)
    below: dict[str, list[Joint]] = {}
    for joint in described.joints:
        below.setdefault(joint.parent, []).append(joint)
    count, order = {described.root: 0}, [described.root]
    for link in order:  # grows meanwhile: every link comes after the one that it hangs from
        for joint in below.get(link, ()):
            count[joint.child] = count[link] + (joint.kind != 'fixed')
            order.append(joint.child)
    # The end that each link leads to, and how many joints lie before it.
    ends: dict[str, tuple[int, str]] = {}
    for link in reversed(order):
        best = count[link], link
        branches = below.get(link, [])
        several = sum(joint.kind != 'fixed' for joint in branches) > 1
        if count[link] < _ARM_JOINTS or not (
                several or any(joint.mimic is not None for joint in branches)):
            for joint in branches:
                found = ends[joint.child]
                if joint.mimic is None and (
                        found[0] > best[0] or (found[0] == best[0] and joint.kind == 'fixed')):
                    best = found
        ends[link] = best
    return ends[described.root][1]


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
    return str(yaml.safe_dump({'/**': {'ros__parameters': values}}, sort_keys=False))

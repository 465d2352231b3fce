"""Parameter files as the nodes and everything offline read them, and what stands in them.

Nothing here needs ROS, or compiled mathematics: a node without any starts at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from redundant_planner.core.errors import known, ParameterError, PlannerError, shown, unknown_names
from redundant_planner.core.parameters import (
    AXES,
    check,
    COMMAND_FRAMES,
    is_number,
    parameter,
    PlannerParameters,
    ros_name,
    spec_of,
)
from redundant_planner.io.node_parameters import (
    ClockParameters,
    FakeHardwareParameters,
    PlannerNodeParameters,
    PlayerParameters,
)
from redundant_planner.io.perception_parameters import (
    CameraParameters,
    CloudParameters,
    SceneParameters,
)
from redundant_planner.io.physics_parameters import MujocoHardwareParameters, PhysicsParameters
from redundant_planner.io.resources import read_text, resolve, yaml_content
from redundant_planner.io.xacro_files import urdf_in

Settings = TypeVar('Settings')

# What a parameter file may hold besides the fields of the parameter dataclasses: named things, and
# what every ROS node takes.
_NAMED = ('capsule', 'static_obstacle', 'self_capsule')

# In `locked_joints`, for all joints outside the chain that it does not name.
OTHERS_MEASURED = '*=measured'

_EVERY_NODES = ('use_sim_time', 'qos_overrides', 'start_type_description_service')


@dataclass(frozen=True)
class RobotParameters:
    """What the planner must know of an arm; fixed while a node runs.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    urdf: str = parameter(
        '', description='URDF file: a path, file:// or package://. Empty: robot_description, '
                        'parameter or topic.')
    robot_description: str = parameter(
        '', description="The URDF's text, used where urdf is empty.")
    base_frame: str = parameter(
        '', description='Link in whose frame commands and obstacles are given; empty for the '
                        'root.')
    tip_frame: str = parameter(
        '', description='Link whose origin is the end effector. This or tips is required.')
    tips: tuple[str, ...] = parameter(
        (), description='Such links of a body with several arms, with topics TIP/cmd_vel and '
                        'TIP/target_pose.')
    base: str = parameter(
        '', choices=('', 'holonomic'),
        description='holonomic: a base that moves in any direction of the plane, by odom and '
                    'base_cmd_vel.')
    base_weight: float = parameter(
        30.0, group='base', low=1e-3, high=1e6,
        description='Cost of moving the base, beside 1 of each joint.')
    base_speed: tuple[float, ...] = parameter(
        (0.5, 1.0), group='base', low=1e-3, high=100.0, unit='m/s, rad/s',
        description='Largest speed of the base, linear and angular.')
    base_acceleration: tuple[float, ...] = parameter(
        (0.5, 1.0), group='base', low=1e-3, high=1e3, unit='m/s², rad/s²',
        description='Largest acceleration of the base, linear and angular.')
    base_room: float = parameter(
        5.0, group='base', low=0.1, high=1e3, unit='m',
        description='How far the base may go along x and y from its start.')
    mount_frame: str = parameter(
        '', description='Frame in which the base stands at mount_pose; commands and obstacles are '
                        'given in it.')
    mount_pose: tuple[float, ...] = parameter(
        (), low=-1e3, high=1e3, unit='m, rad',
        description='Pose of the root link in mount_frame: x y z, then nothing, roll pitch yaw, '
                    'or a quaternion.')
    axes: tuple[str, ...] = parameter(
        AXES, choices=AXES,
        description='Controlled axes of the twist; the null space has the others.')
    command_frame: str = parameter(
        'base', choices=COMMAND_FRAMES,
        description='Axes of cmd_vel: base (fixed) or tool (turning with the tip).')
    locked_joints: tuple[str, ...] = parameter(
        (), description="Joints that stand still, as 'joint=position'; '*=measured': all outside "
                        'the chain, where they are at the start.')
    position_limits: tuple[str, ...] = parameter(
        (), unit='rad, m',
        description="Ranges narrower than the URDF's, as 'joint=low..high'.")
    velocity_max: tuple[float, ...] = parameter(
        (), low=1e-6, high=1e4, unit='rad/s, m/s',
        description="Replaces the URDF's velocity limits: one value, or one per joint.")
    acceleration_max: tuple[float, ...] = parameter(
        (), low=1e-6, high=1e6, unit='rad/s², m/s²',
        description="Largest joint acceleration, one value or one per joint. Empty: the URDF's, "
                    'or 5. Too high, and the arm overshoots limits and clearances.')
    jerk_max: tuple[float, ...] = parameter(
        (), low=1e-6, unit='rad/s³, m/s³',
        description="Largest joint jerk, one value or one per joint. Empty: the URDF's, or 100/s "
                    'times acceleration_max. Lower is smoother, and later.')
    link_shapes: str = parameter(
        'fitted', choices=('fitted', 'straight'),
        description='Without capsules: fitted around the collision geometry, or straight between '
                    'joints.')
    link_radius: float = parameter(
        0.0, low=0.0, high=1.0, unit='m',
        description='Radius of straight link shapes. Too small, and the arm touches things.')
    capsules: tuple[str, ...] = parameter(
        (), description='Names of the link shapes; each has capsule.NAME.frame, .start, .end and '
                        '.radius.')

    def __post_init__(self) -> None:
        """Check every value and the relations between them."""
        check(self)
        for name in ('base_speed', 'base_acceleration'):
            if len(getattr(self, name)) != 2:
                raise ParameterError(f"parameter '{name.replace('_', '.')}' has "
                                     f'{len(getattr(self, name))} numbers; it takes two, linear '
                                     'and angular')
        if self.base and self.mount_frame:
            raise ParameterError("parameter 'mount_frame' is set, and 'base', too: what stands on "
                                 'a base stands nowhere else; leave one of them empty')
        for entry in self.locked_joints:
            name, _, position = entry.partition('=')
            if entry != OTHERS_MEASURED and not (name and is_number(position)):
                raise ParameterError(
                    f"parameter 'locked_joints' has {shown(entry)}; it takes 'joint=position', "
                    f"a joint's name and a number [rad, m], or '{OTHERS_MEASURED}'")
        named = [entry.partition('=')[0] for entry in self.position_limits]
        for entry, name in zip(self.position_limits, named):
            low, dots, high = entry.partition('=')[2].partition('..')
            # Three dots may belong to either number.
            if not (name and dots and is_number(low) and is_number(high)) or '...' in entry:
                raise ParameterError(
                    f"parameter 'position_limits' has {shown(entry)}; it takes 'joint=low..high', "
                    "a joint's name and two numbers [rad, m]")
            if named.count(name) > 1:
                raise ParameterError(f"parameter 'position_limits' names {shown(name)} twice")

    @property
    def position_ranges(self) -> dict[str, tuple[float, float]]:
        """Joint name → the lowest and highest position that `position_limits` gives [rad, m]."""
        ranges = {}
        for entry in self.position_limits:
            name, _, text = entry.partition('=')
            low, _, high = text.partition('..')
            ranges[name] = float(low), float(high)
        return ranges

    @property
    def locked(self) -> dict[str, float]:
        """Joint name → where it stands [rad, m]."""
        named = (entry.partition('=') for entry in self.locked_joints if entry != OTHERS_MEASURED)
        return {name: float(position) for name, _, position in named}


# All groups of parameters that the nodes have.
SETTINGS = (RobotParameters, PlannerParameters, PlannerNodeParameters, FakeHardwareParameters,
            ClockParameters, PlayerParameters, CloudParameters, CameraParameters,
            SceneParameters, PhysicsParameters, MujocoHardwareParameters)


def urdf_text(parameters: RobotParameters, folder: Path | None = None) -> str:
    """Return the URDF that the parameters name or hold; empty if they do neither.

    Args:
        parameters: from a node or a file.
        folder: for a relative path; the working directory if None.

    Raises:
        PlannerError: there is no such file, or it has macros that cannot be expanded.
    """
    if parameters.urdf:
        return urdf_in(resolve(parameters.urdf, folder))
    return parameters.robot_description


def urdf_folder(parameters: RobotParameters, folder: Path | None = None) -> Path | None:
    """Return the folder of the URDF file, for meshes relative to it; None without a file."""
    return resolve(parameters.urdf, folder).parent if parameters.urdf else None


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
    names = {ros_name(entry): entry.name for entry in fields(settings)}  # type: ignore[arg-type]
    return settings(**{names[name]: value for name, value in flat(values).items()
                       if name in names})


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
    values = flat(parameter_values(content, what))
    unknown = unknown_names(values, known_parameters())
    if unknown:
        raise ParameterError(f'{what}: ' + '; '.join(unknown))
    return values


def flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameter values with those of a group under their full names, `group.name`."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping) and name not in (*_NAMED, *_EVERY_NODES):
            found |= {f'{name}.{key}': inner for key, inner in value.items()}
        else:
            found[name] = value
    return found


def known_parameters() -> list[str]:
    """Return the names that a file for this package's nodes may set."""
    return [*(ros_name(entry) for group in SETTINGS for entry in fields(group)
              if spec_of(entry).node), *_NAMED, *_EVERY_NODES]


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

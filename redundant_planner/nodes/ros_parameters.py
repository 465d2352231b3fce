"""Parameter dataclasses as ROS parameters: declared, described and checked from one place."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import Field, fields, replace
import math
import sys
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from redundant_planner.core.errors import ParameterError, PlannerError, shown, unknown_names
from redundant_planner.core.parameters import checked, PlannerParameters, ros_name, spec_of
from redundant_planner.io.node_parameters import (
    ClockParameters,
    FakeHardwareParameters,
    PlannerNodeParameters,
    PlayerParameters,
)
from redundant_planner.io.parameter_files import RobotParameters, SETTINGS
from redundant_planner.io.perception_parameters import (
    CameraParameters,
    CloudParameters,
    SceneParameters,
)
from redundant_planner.io.physics_parameters import MujocoHardwareParameters, PhysicsParameters
from redundant_planner.io.poses import POSE_SIZES
from redundant_planner.nodes.disputed_parameters import disputed
from redundant_planner.nodes.rclpy_internals import given_parameters

Settings = TypeVar('Settings')

# The keys of a capsule and of a static obstacle, and how many numbers they take: one of several,
# or 'text' for a string.
Size = int | str | tuple[int, ...]
Sizes = Mapping[str, Size]
CAPSULE: Sizes = {'frame': 'text', 'start': 3, 'end': 3, 'radius': 1}
STATIC_OBSTACLE: Sizes = {
    'shape': 'text', 'size': 3, 'pose': POSE_SIZES, 'center': 3, 'semi_axes': 3, 'orientation': 4}


def declare(node: Node, settings: type[Settings]) -> Settings:
    """Declare the fields of a parameter dataclass on a node and return their values.

    Types are checked here and not by rclpy: 1 is taken for 1.0, and the messages say more.

    Raises:
        ParameterError: a value given at start does not fit.
    """
    values = {}
    said = disputed(tuple(sys.argv), node.get_fully_qualified_name())
    for entry in fields(settings):  # type: ignore[arg-type]
        if not spec_of(entry).node:
            continue
        name = ros_name(entry)
        node.declare_parameter(name, None, ParameterDescriptor(dynamic_typing=True))
        given = said.get(name, node.get_parameter(name).value)
        value = entry.default if given is None else checked(entry, given)
        values[entry.name] = value
        if value != ():
            node.set_parameters([Parameter(
                name, value=list(value) if isinstance(value, tuple) else value)])
        node.set_descriptor(name, _descriptor(entry))
    return settings(**values)


def _descriptor(entry: Field[Any]) -> ParameterDescriptor:
    """Return what `ros2 param describe` shows of a field."""
    spec = spec_of(entry)
    descriptor = ParameterDescriptor(
        description=spec.description + (f' [{spec.unit}]' if spec.unit else ''),
        additional_constraints=f'one of: {", ".join(spec.choices)}' if spec.choices else '',
        read_only=not spec.runtime, dynamic_typing=True)
    if math.isfinite(spec.low) and math.isfinite(spec.high):
        if isinstance(entry.default, int):
            descriptor.integer_range = [IntegerRange(
                from_value=int(spec.low), to_value=int(spec.high))]
        elif isinstance(entry.default, float):
            descriptor.floating_point_range = [FloatingPointRange(
                from_value=spec.low, to_value=spec.high)]
    return descriptor


def declare_entries(
    node: Node, prefix: str, names: Iterable[str], sizes: Sizes, *,
    runtime: bool = False,
) -> dict[str, dict[str, Any]]:
    """Read the parameters PREFIX.NAME.KEY of a list of named things.

    Args:
        node: to declare on.
        prefix: for example 'static_obstacle'.
        names: of the things.
        sizes: key → number of floats, or 'text' for a string.
        runtime: whether they may change while the node runs.

    Returns:
        name → key → value, with the keys that were given.

    Raises:
        ParameterError: a value has the wrong type or length.
    """
    entries: dict[str, dict[str, Any]] = {}
    said = disputed(tuple(sys.argv), node.get_fully_qualified_name())
    for name in names:
        entries[name] = {}
        for key, size in sizes.items():
            full = f'{prefix}.{name}.{key}'
            node.declare_parameter(
                full, None, ParameterDescriptor(dynamic_typing=True, read_only=not runtime))
            value = said.get(full, node.get_parameter(full).value)
            if value is not None:
                entries[name][key] = checked_entry(full, value, size)
    return entries


def checked_entry(name: str, value: Any, size: Size) -> Any:
    """Return the value of a named entry.

    Args:
        name: of the parameter, for messages.
        value: as ROS gives it.
        size: number of floats, all that it may be, or 'text' for a string.

    Raises:
        ParameterError: it has the wrong type or length, or a number is not finite.
    """
    if size == 'text':
        if not isinstance(value, str):
            raise ParameterError(f"parameter '{name}' is {shown(value)}; it must be a string")
        return value
    listed = isinstance(value, Iterable) and not isinstance(value, (str, bytes, Mapping))
    items = list(value) if listed else [value]
    counts = size if isinstance(size, tuple) else (size,)
    if len(items) not in counts or not all(
            isinstance(i, (int, float)) and not isinstance(i, bool) and abs(i) < math.inf
            for i in items):
        raise ParameterError(f"parameter '{name}' is {shown(items if listed else value)}; it "
                             f'takes {" or ".join(map(str, counts))} finite number'
                             + ('s' if size != 1 else ''))
    try:
        return [float(i) for i in items] if size != 1 else float(items[0])
    except OverflowError:
        raise ParameterError(f"parameter '{name}' has a number that is too large") from None


# Parameters that every node has.
_ROS = ('use_sim_time', 'start_type_description_service')


def refuse_unknown_parameters(node: Node) -> None:
    """Refuse parameters that were given to a node and that nobody reads.

    rclpy ignores them without a word, and an arm without its misspelt speed limit would be
    dangerous. Those of this package's other nodes are known, as the nodes share their files; so
    are the entries of obstacles and capsules, where the node does not list any.

    Raises:
        ParameterError: there are some; with the names that were probably meant.
    """
    names = {*_ROS, *node.list_parameters([], 0).names}
    for settings in SETTINGS:
        names |= {ros_name(entry) for entry in fields(settings) if spec_of(entry).node}
    not_mine = ['qos_overrides.']
    for prefix, listed, sizes in (
            ('capsule', 'capsules', CAPSULE), ('self_capsule', 'self_capsules', CAPSULE),
            ('static_obstacle', 'static_obstacles', STATIC_OBSTACLE)):
        if node.has_parameter(listed):
            names |= {f'{prefix}.{name}.{key}' for name in node.get_parameter(listed).value or ()
                      for key in sizes}
        else:
            not_mine.append(f'{prefix}.')
    given = given_parameters(node)
    if given is None:
        node.get_logger().warning('this rclpy does not tell which parameters were given: a '
                                  'misspelt one stays unnoticed')
        return
    unknown = unknown_names(
        (name for name in given if not name.startswith(tuple(not_mine))), names)
    if unknown:
        raise ParameterError('; '.join(unknown))


def on_change(
    node: Node, current: Callable[[], tuple[Any, ...]], apply: Callable[..., None],
    prefix: str, sizes: Sizes,
) -> None:
    """Let the runtime parameters of the given dataclasses change while the node runs.

    A change is applied as a whole or refused as a whole, with the reason.

    Args:
        node: whose parameters change.
        current: returns the settings in use, one instance per dataclass.
        apply: takes the new settings, in the same order, and a dictionary of the changed
            entries, (name, key) → value; may raise PlannerError to refuse.
        prefix, sizes: of the named entries that may change, as for `declare_entries`.
    """

    def callback(parameters: list[Parameter]) -> SetParametersResult:
        changes = {change.name: change.value for change in parameters}
        try:
            apply(*changed(current(), changes), changed_entries(prefix, sizes, changes))
        except PlannerError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(callback)


def changed(settings: Iterable[Any], changes: Mapping[str, Any]) -> list[Any]:
    """Return parameter dataclasses with those changes that are theirs.

    Raises:
        ParameterError: a value does not fit.
    """
    return [replace(setting, **{entry.name: changes[ros_name(entry)] for entry in fields(setting)
                                if ros_name(entry) in changes}) for setting in settings]


def changed_entries(
    prefix: str, sizes: Sizes, changes: Mapping[str, Any],
) -> dict[tuple[str, str], Any]:
    """Return those changes that are of entries PREFIX.NAME.KEY, (name, key) → value.

    A name may have dots.

    Raises:
        ParameterError: a value does not fit.
    """
    entries = {}
    for full, value in changes.items():
        if full.startswith(f'{prefix}.'):
            name, _, key = full[len(prefix) + 1:].rpartition('.')
            if key in sizes:
                entries[name, key] = checked_entry(full, value, sizes[key])
    return entries


def rows_of(settings: type[Any]) -> list[str]:
    """Return the table rows of the parameters that nodes declare."""
    rows = []
    for entry in fields(settings):
        spec = spec_of(entry)
        if not spec.node:
            continue
        allowed = ', '.join(choice or "''" for choice in spec.choices)
        if math.isfinite(spec.low) or math.isfinite(spec.high):
            allowed = f'{spec.low:g}…{spec.high:g}'.replace('inf', '∞')
        allowed = f'{allowed} {spec.unit}'.strip()
        default = list(entry.default) if isinstance(entry.default, tuple) else entry.default
        rows.append(f'| `{ros_name(entry)}`{" ●" if spec.runtime else ""} | `{default!r}` | '
                    f'{allowed} | {spec.description} |')
    return rows


def parameter_page() -> str:
    """Return docs/parameters.md: every parameter, as declared."""
    lines = [
        '# Parameters', '',
        '<!-- Made by `python -m redundant_planner.nodes.ros_parameters`; do not edit. -->', '',
        'Parameters marked ● may change while the node runs (`ros2 param set`). The node refuses '
        'a value that does not fit, with the reason.', '']
    simulated = rows_of(FakeHardwareParameters)
    for title, *groups in (
            ('All nodes but scenario_player: the robot', RobotParameters),
            ('planner_node: the mathematics', PlannerParameters),
            ('planner_node: the loop', PlannerNodeParameters),
            ('fake_hardware_node', FakeHardwareParameters),
            ('mujoco_hardware_node, besides those of fake_hardware_node',
             MujocoHardwareParameters, PhysicsParameters),
            ('Both simulated arms: simulated time', ClockParameters),
            ('scenario_player', PlayerParameters),
            ('cloud_obstacles', CloudParameters),
            ('planning_scene_obstacles', SceneParameters),
            ('depth_camera', CameraParameters)):
        lines += [f'## {title}', '',
                  '| parameter | default | range | meaning |', '|---|---|---|---|']
        rows = [row for settings in groups for row in rows_of(settings)]
        lines += [row for row in rows if MujocoHardwareParameters not in groups
                  or row not in simulated] + ['']
    return '\n'.join(lines)


if __name__ == '__main__':
    print(parameter_page(), end='')

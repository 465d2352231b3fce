"""Parameter dataclasses as ROS parameters: declared, described and checked from one place."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, Field, fields, replace
import math
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from redundant_planner.core.errors import ParameterError, PlannerError
from redundant_planner.core.parameters import check, checked, parameter, PlannerParameters, spec_of
from redundant_planner.nodes.command_output import OUTPUTS
from redundant_planner.robot_parameters import RobotParameters

Settings = TypeVar('Settings')


@dataclass(frozen=True)
class PlannerNodeParameters:
    """What planner_node needs besides the robot and the mathematics.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    rate: int = parameter(
        250, low=1, high=1000, unit='Hz',
        description='Rate of joint_command. A slow rate makes every margin coarser.')
    incoming_command_timeout: float = parameter(
        0.1, low=0.005, high=10.0, unit='s', runtime=True,
        description='A cmd_vel older than this counts as zero. Long timeouts let the arm run on '
                    'after its operator has gone.')
    joint_state_timeout: float = parameter(
        0.1, low=0.005, high=10.0, unit='s', runtime=True,
        description='Without joint_states for this long the arm is stopped and nothing is '
                    'published until they are back.')
    position_tolerance: float = parameter(
        0.1, low=1e-3, high=10.0, unit='rad, m',
        description='Everything starts again from the measured posture when it jumps by more than '
                    'this beyond what the arm can travel, and the commanded positions when they '
                    'are further from it than this.')
    enable_stamped_cmd_vel: bool = parameter(
        False, description='cmd_vel is TwistStamped instead of Twist: it says its frame (base or '
                           'tip) and when it was meant.')
    estimate_obstacle_velocity: bool = parameter(
        False, runtime=True,
        description='Obstacles seen at one place after another are taken to move on like that, '
                    'and are evaded earlier. Noisy detections make the arm flinch.')
    outputs: tuple[str, ...] = parameter(
        (), choices=OUTPUTS,
        description='Topics besides joint_command: position_commands or velocity_commands '
                    '(Float64MultiArray, for forward_command_controller), joint_trajectory (for '
                    'joint_trajectory_controller).')
    publish_ticks: bool = parameter(
        False, description='Whether every input of every tick is published on ~/ticks: a bag of '
                           'them can be replayed to the last digit.')
    diagnostics_rate: float = parameter(
        5.0, low=0.0, high=50.0, unit='Hz', description='Rate of /diagnostics; 0 for none.')
    marker_rate: float = parameter(
        5.0, low=0.0, high=50.0, unit='Hz',
        description='Rate of ~/markers while somebody listens; 0 for none.')
    thread_priority: int = parameter(
        40, low=0, high=98,
        description='Real-time priority (SCHED_FIFO) of the loop, where the system grants it; 0 '
                    'for none. Without it a busy machine makes the period jitter.')
    static_obstacles: tuple[str, ...] = parameter(
        (), description='Names of fixed obstacles; each has the parameters '
                        'static_obstacle.NAME.center, .semi_axes and optionally .orientation '
                        '(x y z w).')

    def __post_init__(self) -> None:
        """Check every value."""
        check(self)


@dataclass(frozen=True)
class FakeHardwareParameters:
    """What fake_hardware_node needs besides the URDF.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    rate: int = parameter(
        250, low=1, high=1000, unit='Hz', description='Rate of joint_states.')
    command_timeout: float = parameter(
        0.05, low=0.001, high=10.0, unit='s',
        description='The arm holds still when no joint_command came for this long.')
    initial_joints: tuple[str, ...] = parameter(
        (), description='Joints that do not start at 0.')
    initial_positions: tuple[float, ...] = parameter(
        (), unit='rad, m', description='One start position per name in initial_joints.')
    lag: float = parameter(
        0.0, low=0.0, high=1.0, unit='s',
        description='Dead time between a command and the motion it causes.')
    noise: float = parameter(
        0.0, low=0.0, high=0.1, unit='rad, m',
        description='Standard deviation of the noise on published positions.')
    thread_priority: int = parameter(
        40, low=0, high=98,
        description='Real-time priority (SCHED_FIFO), where the system grants it; 0 for none. '
                    'Without it a busy machine interrupts joint_states, as no real arm would.')

    def __post_init__(self) -> None:
        """Check every value and the relations between them."""
        check(self)
        if len(self.initial_joints) != len(self.initial_positions):
            raise ParameterError(
                f"parameter 'initial_positions' has {len(self.initial_positions)} entries; it "
                f"takes {len(self.initial_joints)}, one per name in 'initial_joints'")


def declare(node: Node, settings: type[Settings]) -> Settings:
    """Declare the fields of a parameter dataclass on a node and return their values.

    Types are checked here and not by rclpy: 1 is taken for 1.0, and the messages say more.

    Raises:
        ParameterError: a value given at start does not fit.
    """
    values = {}
    for entry in fields(settings):  # type: ignore[arg-type]
        node.declare_parameter(entry.name, None, ParameterDescriptor(dynamic_typing=True))
        given = node.get_parameter(entry.name).value
        value = entry.default if given is None else checked(entry, given)
        values[entry.name] = value
        if value != ():
            node.set_parameters([Parameter(
                entry.name, value=list(value) if isinstance(value, tuple) else value)])
        node.set_descriptor(entry.name, _descriptor(entry))
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
    node: Node, prefix: str, names: Iterable[str], sizes: Mapping[str, int | str], *,
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
    for name in names:
        entries[name] = {}
        for key, size in sizes.items():
            full = f'{prefix}.{name}.{key}'
            node.declare_parameter(
                full, None, ParameterDescriptor(dynamic_typing=True, read_only=not runtime))
            value = node.get_parameter(full).value
            if value is not None:
                entries[name][key] = _checked_entry(full, value, size)
    return entries


def _checked_entry(name: str, value: Any, size: int | str) -> Any:
    if size == 'text':
        if not isinstance(value, str):
            raise ParameterError(f"parameter '{name}' is {value!r}; it must be a string")
        return value
    items = list(value) if not isinstance(value, (int, float, str)) else [value]
    if len(items) != size or not all(
            isinstance(i, (int, float)) and not isinstance(i, bool) for i in items):
        raise ParameterError(f"parameter '{name}' is {items}; it takes {size} number"
                             + ('s' if size != 1 else ''))
    return [float(i) for i in items] if size != 1 else float(items[0])


def on_change(
    node: Node, current: Callable[[], tuple[Any, ...]], apply: Callable[..., None],
    entries: str,
) -> None:
    """Let the runtime parameters of the given dataclasses change while the node runs.

    A change is applied as a whole or refused as a whole, with the reason.

    Args:
        node: whose parameters change.
        current: returns the settings in use, one instance per dataclass.
        apply: takes the new settings, in the same order, and a dictionary of the changed
            entries; may raise PlannerError to refuse.
        entries: prefix of the named entries that may change (`declare_entries`).
    """

    def callback(parameters: list[Parameter]) -> SetParametersResult:
        settings, others = list(current()), {}
        try:
            for change in parameters:
                if change.name.startswith(f'{entries}.'):
                    others[change.name] = change.value
                for i, setting in enumerate(settings):
                    entry = next((f for f in fields(setting) if f.name == change.name), None)
                    if entry is None:
                        continue
                    settings[i] = replace(setting, **{change.name: change.value})
            apply(*settings, others)
        except PlannerError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(callback)


def parameter_page() -> str:
    """Return docs/parameters.md: every parameter, as declared."""
    lines = [
        '# Parameters', '',
        '<!-- Made by `python -m redundant_planner.nodes.ros_parameters`; do not edit. -->', '',
        'Parameters marked ● may change while the node runs (`ros2 param set`); a value that '
        'does not fit is refused with the reason, and nothing changes.', '']
    for title, settings in (
            ('planner_node and fake_hardware_node: the robot', RobotParameters),
            ('planner_node: the mathematics', PlannerParameters),
            ('planner_node: the loop', PlannerNodeParameters),
            ('fake_hardware_node', FakeHardwareParameters)):
        lines += [f'## {title}', '', '| parameter | default | unit | range | meaning |',
                  '|---|---|---|---|---|']
        for entry in fields(settings):
            spec = spec_of(entry)
            allowed = ', '.join(spec.choices)
            if math.isfinite(spec.low) or math.isfinite(spec.high):
                allowed = f'{spec.low:g} … {spec.high:g}'.replace('inf', '∞')
            default = list(entry.default) if isinstance(entry.default, tuple) else entry.default
            lines.append(f'| `{entry.name}`{" ●" if spec.runtime else ""} | `{default!r}` | '
                         f'{spec.unit} | {allowed} | {spec.description} |')
        lines.append('')
    return '\n'.join(lines)


if __name__ == '__main__':
    print(parameter_page(), end='')

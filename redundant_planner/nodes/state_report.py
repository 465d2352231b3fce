"""The state of the control loop, and what /diagnostics says of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.model import Robot
from redundant_planner.core.step_result import Nearest, StepResult
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import Target, TipTargets
from redundant_planner.core.target.progress import TargetState
from redundant_planner.nodes.target_text import TARGET, text_of_target

Array = npt.NDArray[np.float64]

# What ~/target says of an arm that does not do what it is told.
DOES_NOT_FOLLOW = 'does not follow'
_LEFT = ('distance [m]', 'angle [rad]', 'expected time [s]', 'ends off by [m, rad]',
         'farthest joint [rad, m]')
# What ~/target says besides while the arm follows a chunk.
_ALONG = ('behind [s]', 'beside the chunk [m, rad]')
# Tick times that are kept until the next report.
_TICKS = 5000


@dataclass
class LoopState:
    """The loop as it is now.

    Attributes:
        hold: why the arm is at rest or being brought to rest, empty while the planner moves it.
        fault: whether `hold` is a fault, rather than the start or the operator's wish.
        trouble: what is wrong with the inputs without holding the arm.
        astray: why the arm did not follow, until it does.
        unheard: which outputs nobody hears.
        blind: which topics of obstacles say nothing that can be used.
        result: of the last tick, None before the first.
        tick_times: of the ticks since the last report [s].
        overruns: ticks that took longer than the period, since the start.
        jerk_given_up: ticks in which the jerk limits gave way to a clearance, since the start.
        faults, last_fault: number of unforeseen exceptions since the start, and the latest one.
        last_word: state of the process that stops the arm should this one die.
        listeners: output → number of its listeners.
        joint_state_age, command_age, obstacle_age: [s], infinite before the first message.
    """

    hold: str = 'waiting for joint_states'
    fault: bool = False
    trouble: str = ''
    astray: str = ''
    unheard: str = ''
    blind: str = ''
    result: StepResult | None = None
    tick_times: deque[float] = field(default_factory=lambda: deque(maxlen=_TICKS))
    overruns: int = 0
    jerk_given_up: int = 0
    faults: int = 0
    last_fault: str = ''
    last_word: str = 'starting'
    listeners: dict[str, int] = field(default_factory=dict)
    joint_state_age: float = np.inf
    command_age: float = np.inf
    obstacle_age: float = np.inf


def status_of(
    name: str, robot: Robot, state: LoopState, q: Array | None, method: str, margin: float,
    obstacles: int, attached: Collection[str],
) -> DiagnosticStatus:
    """Return one entry of /diagnostics.

    Args:
        name: of the node.
        robot: the arm.
        state: of the loop.
        q: (n,) latest measurement, None without one.
        method: in use.
        margin: that the distances of the loop's results are beyond [m].
        obstacles: their number.
        attached: names of what the hand holds.
    """
    result = state.result
    level, message = _verdict(state)
    values = {
        'method': method,
        'limited by': result.reason if result is not None else '',
        'obstacles': str(obstacles),
        'attached': ', '.join(sorted(attached)),
        'tick time, median [us]': _number(1e6, np.median, state.tick_times),
        'tick time, longest [us]': _number(1e6, np.max, state.tick_times),
        'overruns': str(state.overruns),
        'ticks without jerk limits': str(state.jerk_given_up),
        'faults': str(state.faults),
        'last fault': state.last_fault,
        'last word': state.last_word,
        'listeners': ', '.join(f'{name}: {count}' for name, count in state.listeners.items()),
        'age of joint_states [s]': f'{state.joint_state_age:.3f}',
        'age of cmd_vel [s]': f'{state.command_age:.3f}',
        'age of obstacles [s]': f'{state.obstacle_age:.3f}',
    }
    if result is not None:
        values |= _of_result(result, robot.tips, margin)
    if q is not None:
        room = np.minimum(robot.position_max - q, q - robot.position_min)
        least = int(room.argmin())
        values['smallest limit margin'] = f'{room[least]:.4f} ({robot.joint_names[least]})'
    return DiagnosticStatus(
        level=level, name=f'{name}: planner', message=message, hardware_id=robot.name,
        values=[KeyValue(key=key, value=value) for key, value in values.items()])


def _verdict(state: LoopState) -> tuple[bytes, str]:
    """Return the level of /diagnostics, and why it is that; the worst counts."""
    reason = state.result.reason if state.result is not None else ''
    if state.hold:
        return DiagnosticStatus.ERROR if state.fault else DiagnosticStatus.WARN, state.hold
    if error := state.astray or state.blind:
        return DiagnosticStatus.ERROR, error
    if warning := state.trouble or state.unheard or reason:
        return DiagnosticStatus.WARN, warning
    return DiagnosticStatus.OK, 'planning'


def _of_result(result: StepResult, tips: Sequence[str], margin: float) -> dict[str, str]:
    """Return what /diagnostics says of the last tick.

    Args:
        result: of the tick.
        tips: of the robot.
        margin: that its distances are beyond [m].
    """
    values = {
        'factor k': f'{result.factor:.6g}',
        'twist scale s': f'{result.scale:.4f}',
        'stage': result.stage.name,
        'manipulability': f'{result.manipulability:.6g}',
        'path error [m]': _length(result.path_error),
        'nearest pair': _pair(result.nearest),
        # Of the surfaces, as on the page and in reports; the planner counts from its margin.
        'nearest distance [m]': _metres(result.nearest, margin),
        'beyond the margin [m]': _metres(result.nearest),
    }
    for tip, found in zip(tips, result.tips):
        values |= {f'twist scale s ({tip})': f'{found.scale:.4f}',
                   f'path error ({tip}) [m]': _length(found.path_error)}
    return values


def progress_status(
    name: str, robot: Robot, target: Target | TipTargets | None, result: StepResult | None,
    astray: str = '',
) -> DiagnosticStatus:
    """Return the entry of ~/target.

    Args:
        name: of the node.
        robot: the arm.
        target: None without one.
        result: of the last tick.
        astray: why the arm does not follow, and lets go of its target; empty if it does.
    """
    status = DiagnosticStatus(name=f'{name}: target', message='no target')
    if astray and target is not None:
        status.level, status.message = DiagnosticStatus.ERROR, DOES_NOT_FOLLOW
        status.values = [KeyValue(key=key, value=value) for key, value in {
            **dict.fromkeys(_LEFT, 'nan'), 'limited by': astray,
            TARGET: text_of_target(target, robot.joint_names)}.items()]
        return status
    progress = result.progress if result is not None else None
    if result is None or target is None or progress is None:
        return status
    stopped = progress.state in (TargetState.BLOCKED, TargetState.OUT_OF_REACH)
    status.level = DiagnosticStatus.WARN if stopped else DiagnosticStatus.OK
    status.message = progress.state.value
    left = (f'{progress.distance:.6f}', f'{progress.angle:.6f}', f'{progress.seconds:.3f}',
            f'{progress.miss:.4f}', f'{progress.joint:.6f}')
    chunked = isinstance(target, Chunk) or (isinstance(target, Mapping) and any(
        isinstance(at, Chunk) for at in target.values()))
    along = (f'{progress.behind:.3f}', f'{progress.beside:.6f}') if chunked else ()
    status.values = [KeyValue(key=key, value=value) for key, value in {
        **dict(zip(_LEFT, left)), **dict(zip(_ALONG, along)),
        'limited by': result.reason,
        TARGET: text_of_target(target, robot.joint_names),
    }.items()]
    return status


def _number(unit: float, statistic: object, values: Collection[float]) -> str:
    if not values:
        return ''
    return f'{unit * float(statistic(list(values))):.0f}'  # type: ignore[operator]


def _length(error: Array) -> str:
    """Return the length of the translation in an error (6,) [m, rad]."""
    return f'{float(np.linalg.norm(error[:3])):.6f}'


def _pair(nearest: Nearest | None) -> str:
    return f'{nearest.link} to {nearest.obstacle}' if nearest else ''


def _metres(nearest: Nearest | None, more: float = 0.0) -> str:
    return f'{nearest.beyond_margin + more:.4f}' if nearest else 'inf'


def diagnostics(status: DiagnosticStatus, stamp: object) -> DiagnosticArray:
    """Return the message that holds one status."""
    message = DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message

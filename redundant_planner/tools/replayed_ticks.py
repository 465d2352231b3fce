"""The recorded ticks of a planner computed once more, with its own or with other parameters."""

from __future__ import annotations

from dataclasses import dataclass
import sys

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track

from redundant_planner.analysis.replay_inputs import checksum_at, Inputs, rate_of, ticks_of_topics
from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.horizon.preview import TwistAhead
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.safety.jerk import SmoothStop
from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.latest_chunks import LatestChunks
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.io.payload import Payload
from redundant_planner.io.recorded_configuration import recorded_obstacles, recorded_walls
from redundant_planner.io.recorded_inputs import as_it_is
from redundant_planner.io.recorded_target import RecordedTarget
from redundant_planner.io.recorded_tick import RecordedTick, TickKind
from redundant_planner.paper.method import PaperPlanner, planner_of

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Replay:
    """The commands of a replay.

    Attributes:
        times: (k,) from the bag's first message [s].
        positions, velocities: (k, n).
        twists: (k, 6) commanded, in the command frame.
    """

    times: Array
    positions: Array
    velocities: Array
    twists: Array


def again(inputs: Inputs, parameters: PlannerParameters) -> Replay:
    """Compute the recorded ticks again from their own inputs, measurements included.

    With the recorded parameters this gives the recorded commands back.

    Raises:
        RecordingError: the ticks were not recorded from their beginning.
    """
    return _rows(inputs, parameters, inputs.ticks[_first_start(inputs):], measured=True)


def _first_start(inputs: Inputs) -> int:
    """Return the first tick whose past does not matter."""
    for i, (_, tick) in enumerate(inputs.ticks):
        if tick.kind == TickKind.STARTING:
            return i
    raise RecordingError('the bag has no start of a motion on ticks; record from before the '
                         'planner starts, or after a reset')


def otherwise(inputs: Inputs, parameters: PlannerParameters) -> Replay:
    """Run the planner and an ideal arm from the first joint state on, on the recorded commands."""
    ticks = inputs.ticks
    if not ticks:
        ticks = ticks_of_topics(inputs)
    return _rows(inputs, parameters, ticks, measured=False)


def differences(inputs: Inputs, replay: Replay) -> Array:
    """Return how far each replayed command is from the recorded one, (k,); lost ones are left out.

    Where simulated time stood still, ticks have the same stamp; the last one's command counts.

    Args:
        inputs: of the bag.
        replay: from `again`.
    """
    ticks = inputs.ticks[_first_start(inputs):]
    replayed = {tick.stamp_ns: dq for (_, tick), dq in zip(ticks, replay.velocities)}
    apart = np.array([np.abs(inputs.commands[stamp] - dq).max()
                      for stamp, dq in replayed.items() if stamp in inputs.commands])
    return apart[np.isfinite(apart)]  # a command without velocities tells nothing


def _rows(
    inputs: Inputs, parameters: PlannerParameters, ticks: list[tuple[float, RecordedTick]], *,
    measured: bool,
) -> Replay:
    """Step through ticks, at measured postures or at those of an ideal arm.

    Raises:
        RecordingError: there are none.
    """
    if not ticks:
        raise RecordingError('the bag is too short: no tick lies between its first joint state '
                             'and its last')
    dt, count, n = 1.0 / rate_of(inputs.values), len(ticks), inputs.robot.n
    planned = _Planned(inputs, parameters, dt)
    # Ticks that are made up start again after every pause, where the arm was then.
    made_up = not inputs.ticks
    q: Array = ticks[0][1].q
    positions, velocities = np.empty((count, n)), np.empty((count, n))
    for i, (_, tick) in enumerate(track(
            ticks, description='replaying', console=Console(stderr=True), transient=True,
            disable=not sys.stderr.isatty())):
        starts = tick.kind == TickKind.STARTING and (measured or made_up or i == 0)
        if measured or starts:
            q = tick.q
        planned.hear(tick)
        if measured:
            planned.miss(tick)
        dq = (planned.brake() if measured and tick.kind == TickKind.BRAKING
              else planned.step(tick, q, starts=starts))
        positions[i], velocities[i] = q, dq
        q = q + dt * dq
    return Replay(np.array([time for time, _ in ticks]), positions, velocities,
                  np.array([tick.twist.ravel()[:6] for _, tick in ticks]).reshape(-1, 6))


class _Planned:
    """A planner that is given again what was recorded, as the control loop gave it."""

    def __init__(self, inputs: Inputs, parameters: PlannerParameters, dt: float) -> None:
        """Begin before the first tick.

        Args:
            inputs: of the bag.
            parameters: of the planner.
            dt: of its ticks [s].
        """
        robot, values = inputs.robot, inputs.values
        self._inputs, self._dt = inputs, dt
        self._planner = planner_of(robot, parameters)
        self._obstacles = ObstacleSources.of(
            len(inputs.obstacles),
            [*recorded_obstacles(values, inputs.notes), *recorded_walls(values, inputs.notes)],
            (), transform=as_it_is,
            estimate_velocity=values.get('estimate_obstacle_velocity') is True)
        self._payload = Payload(robot)
        self._stop = SmoothStop(robot.acceleration_max, robot.jerk_max, dt)
        # How many messages of each topic the planner has heard, and on `attached`.
        self._applied, self._held = [0] * len(inputs.obstacles), 0
        self._counts: list[int] = []  # as the tick before had counted them
        self._previous: float | None = None  # time of the tick before [s]
        self._chunks = LatestChunks()

    def hear(self, tick: RecordedTick) -> None:
        """Take in what came after the tick before, with that tick's time."""
        time = tick.time if self._previous is None else self._previous
        for topic, (first, end) in enumerate(
                _read(self._inputs, self._counts, self._applied, tick)):
            for _, raw in self._inputs.obstacles[topic][first:end]:
                self._obstacles.update(raw, time, topic)
            self._applied[topic] = end
        self._counts = [number for number, _ in tick.checked_messages]
        for _, raw in self._inputs.attached[self._held:tick.attached_messages]:
            self._payload.tracker.update(raw, time)
        self._held = max(self._held, tick.attached_messages)
        self._payload.tracker.expire(time)
        self._hold()
        self._previous = tick.time

    def _hold(self) -> None:
        """Do what the control loop does with what is attached."""
        things = self._payload.changed()
        if things is None:
            return
        try:
            self._planner.hold(things)
        except ObstacleError:
            return
        self._obstacles.hidden = self._payload.names

    def miss(self, tick: RecordedTick) -> None:
        """Note the ticks that did not take place before one."""
        self._planner.missed(tick.missed)

    def brake(self) -> Array:
        """Return the velocities (n,) of a tick without the planner [rad/s, m/s]."""
        dq = self._stop.next()
        self._planner.braked(dq, self._dt)
        return dq

    def step(self, tick: RecordedTick, q: Array, *, starts: bool) -> Array:
        """Return the velocities (n,) of a tick at a posture (n,) [rad/s, m/s].

        Args:
            tick: which.
            q: where the arm is [rad, m].
            starts: whether the planner starts again from there.
        """
        planner = self._planner
        if starts:
            planner.reset()
        self._obstacles.expire(tick.time)
        _couple(planner, tick)
        target = self._chunks.recorded(
            RecordedTarget(tick.target, tick.goes_on, tick.news, tick.tips_go_on))
        dq: Array = planner.step(
            q, tick.twist, self._obstacles.scene, self._dt, _ahead(self._inputs, tick), target,
            news=tick.news, gently=tick.kind == TickKind.TRYING,
            carefully=tick.kind == TickKind.SETTING_OFF).dq
        self._stop.moving(dq)
        return dq


def _couple(planner: Planner | PaperPlanner, tick: RecordedTick) -> None:
    """Do what the control loop does where several tips begin to hold something, or let go."""
    coupled = len(planner.robot.tips) > 1 and tick.twist.ndim == 1
    if not isinstance(planner, Planner) or coupled == (planner.coupling is not None):
        return
    if coupled:
        planner.couple(q=tick.q)
    else:
        planner.uncouple()


def _read(
    inputs: Inputs, counts: list[int], applied: list[int], tick: RecordedTick,
) -> list[tuple[int, int]]:
    """Return which of the recorded messages with obstacles a tick has heard since the one before.

    The latest one is known by its checksum, and how many there were by their counts: the planner
    may have missed some, and the recorder others.

    Args:
        inputs: of the bag.
        counts: of the tick before; none before the first.
        applied: up to which message of each topic the tick before had heard.
        tick: which.

    Returns:
        First message and the end, of each topic.
    """
    checked = tick.checked_messages[:len(applied)]
    unchecked = len(applied) - len(checked)  # the first topic, in earlier bags
    read = [(place, max(place, tick.obstacle_messages)) for place in applied[:unchecked]]
    for i, (count, check) in enumerate(checked):
        place, listed = applied[unchecked + i], inputs.obstacles[unchecked + i]
        before = counts[i] if i < len(counts) else 0
        heard = count - before if count >= before else count  # fewer: another planner began
        # A message that was not recorded changes nothing.
        end = next((end for end in range(place + 1, len(listed) + 1)
                    if checksum_at(listed, end) == check), place) if heard else place
        read.append((max(place, end - heard), end))
    return read


def _ahead(inputs: Inputs, tick: RecordedTick) -> TwistAhead | None:
    if np.isnan(tick.preview_elapsed) or not 0 < tick.preview_messages <= len(inputs.previews):
        return None
    preview, elapsed = inputs.previews[tick.preview_messages - 1][2], tick.preview_elapsed
    if elapsed > preview.times[-1]:
        return None
    return preview.ahead(elapsed)

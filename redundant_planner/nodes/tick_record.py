"""What commands the arm in a tick, and the record of all that led to the tick's command."""

from __future__ import annotations

import array
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.preview import TwistAhead
from redundant_planner.core.target.goal import Target, TipTargets
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.io.latest_chunks import LatestChunks
from redundant_planner.io.recorded_tick import RecordedTick, TickKind
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.obstacle_input import ObstacleInput
from redundant_planner.nodes.tip_commands import TipCommands

Array = npt.NDArray[np.float64]


class Asked(NamedTuple):
    """What the operator asks of a tick.

    Attributes:
        twist: (6,) in the command frame [m/s, rad/s]; of t tips that are not coupled (t, 6).
        ahead: the twists to come; None if they are not known.
        target: that commands the arm in place of the twist; None without one.
        news: targets that came since the last tick, see `Planner.step`.
    """

    twist: Array
    ahead: TwistAhead | None = None
    target: Target | TipTargets | None = None
    news: tuple[Sighting, ...] = ()


class TickRecord:
    """Publishes the inputs of each tick, enough to compute it again."""

    def __init__(
        self, publish: Callable[[array.array[float]], None],
        command: CommandInput | TipCommands, obstacles: ObstacleInput, attached: ObstacleInput,
    ) -> None:
        """Begin without a tick.

        Args:
            publish: takes each tick as a row of numbers.
            command, obstacles, attached: the inputs, which count their messages.
        """
        self._publish = publish
        self._command, self._obstacles, self._attached = command, obstacles, attached
        self._chunks = LatestChunks()

    def write(
        self, stamp_ns: int, now: float, kind: TickKind, q: Array, asked: Asked, missed: int,
    ) -> None:
        """Record a tick; for all of it see `RecordedTick`.

        Args:
            stamp_ns: of the command [ns].
            now: when it began [s].
            kind: what it did.
            q: (n,) measured posture [rad, m].
            asked: what was asked of it.
            missed: ticks that did not take place before it.
        """
        command, target = self._command, self._chunks.to_record(asked.target)
        elapsed = command.preview_elapsed() if asked.ahead is not None else np.nan
        obstacles = tuple(zip(self._obstacles.read_counts, self._obstacles.last_read))
        self._publish(RecordedTick(
            stamp_ns, now, kind, obstacles[0][0], command.previews, elapsed,
            self._attached.read_counts[0], asked.twist, q, target.target, obstacles,
            target.goes_on, asked.news, target.tips_go_on, missed).numbers())

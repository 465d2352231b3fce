"""How a recorded motion came about, as far as the bag tells."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

from redundant_planner.io.recorded_configuration import number_of

# Clocks before 2000 are a simulation's, or were never set [s since 1970].
_FIRST_DATE = 946_684_800


@dataclass(frozen=True)
class RunFacts:
    """How a motion came about; None and empty texts stand for what the bag does not tell.

    Attributes:
        recorded: when the bag began [s since 1970, UTC].
        method: of the planner.
        software: version and commit that published the configuration.
        margin: the least clearance that the planner was to keep, of targets or else [m].
        period: of the planner's loop [s].
        tick_median, tick_longest: computing time of its ticks [s].
    """

    recorded: float | None = None
    method: str = ''
    software: str = ''
    margin: float | None = None
    period: float | None = None
    tick_median: float | None = None
    tick_longest: float | None = None

    @property
    def date(self) -> str:
        """When the bag began, as a text."""
        if self.recorded is None:
            return ''
        return datetime.fromtimestamp(self.recorded, timezone.utc).strftime('%Y-%m-%d %H:%M UTC')


def run_facts(
    values: dict[str, Any], software: str, origin_ns: int, tick_median: float | None,
    tick_longest: float | None,
) -> RunFacts:
    """Return the facts of a run.

    Args:
        values: the planner's recorded parameters.
        software: that recorded them.
        origin_ns: when the bag began [ns since 1970].
        tick_median, tick_longest: of the diagnostics [s].
    """
    method, margin = values.get('method'), number_of(values, 'clearance.margin', -1.0, 1e3)
    if values.get('target.margin') in (0, 0.0):
        margin = 0.0
    margin = min(margin, number_of(values, 'target.margin', margin, 1e3))
    rate = number_of(values, 'rate', 0.0, 1e6)
    begin = origin_ns * 1e-9
    return RunFacts(
        recorded=begin if _FIRST_DATE < begin < 4e9 else None,
        method=method if isinstance(method, str) else '', software=software,
        margin=margin if margin > 0.0 else None, period=1.0 / rate if rate > 0.0 else None,
        tick_median=tick_median, tick_longest=tick_longest)

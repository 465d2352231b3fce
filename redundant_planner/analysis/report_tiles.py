"""The key figures of a motion, each held against its limit."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis.joint_units import joint_units
from redundant_planner.analysis.measure_tables import motion_measures
from redundant_planner.analysis.report_numbers import difference_text, number_text
from redundant_planner.analysis.results import Analysis

Array = npt.NDArray[np.float64]

# A figure counts as within its limit up to this share beyond it: stamps are no more exact.
_TOLERANCE = 0.01
# No parameter bounds these two: the report holds the tip against 1 mm off its path, and 99 of 100
# command periods against this many of the planner's own.
PATH_ERROR_LIMIT = 1.0  # [mm]
_LATE = 1.5


class Tile(NamedTuple):
    """A key figure.

    Attributes:
        title: its name.
        value: None if the bag does not tell.
        unit: of the value and the limit.
        limit: it is held against; None for none.
        at_least: whether the value must not be below the limit, rather than not above it.
        detail: where or of what it is, as a text.
    """

    title: str
    value: float | None
    unit: str
    limit: float | None = None
    at_least: bool = False
    detail: str = ''

    @property
    def good(self) -> bool | None:
        """Whether the value keeps its limit; None without a value or a limit."""
        if self.value is None or self.limit is None:
            return None
        slack = _TOLERANCE * abs(self.limit)
        if self.at_least:
            return self.value >= self.limit - slack
        return self.value <= self.limit + slack


def tiles_of(analysis: Analysis) -> list[Tile]:
    """Return the key figures of a motion, for every bag the same ones in the same order."""
    measures, facts, periods = motion_measures(analysis), analysis.facts, analysis.periods
    robot, period = analysis.robot, facts.period
    inside = ' (inside it)' if (measures['smallest_distance_mm'] or 0.0) < 0.0 else ''
    return [
        Tile('Smallest distance', measures['smallest_distance_mm'], 'mm',
             1e3 * facts.margin if facts.margin is not None else 0.0, True,
             (measures['nearest_pair'] or '') + inside),
        Tile('Tip off its path, at most', measures['largest_path_error_mm'], 'mm',
             PATH_ERROR_LIMIT),
        _share_of_limit('velocity', analysis, robot.velocity_max if robot is not None else None),
        _share_of_limit('acceleration', analysis,
                        robot.acceleration_max if robot is not None else None),
        _share_of_limit('jerk', analysis, robot.jerk_max if robot is not None else None),
        *_joint_paths(analysis),
        Tile('Longest tick', 1e3 * facts.tick_longest if facts.tick_longest is not None else None,
             'ms', 1e3 * period if period is not None else None,
             detail=(f'median {number_text(1e3 * facts.tick_median)} ms'
                     if facts.tick_median is not None else '')),
        Tile('Command period, 99 of 100 within', 1e3 * periods.p99 if periods else None, 'ms',
             _LATE * 1e3 * period if period is not None else None,
             detail=(f'median {number_text(1e3 * periods.median)} ms, '
                     f'longest {number_text(1e3 * periods.longest)} ms' if periods else ''))]


def _share_of_limit(kind: str, analysis: Analysis, limits: Array | None) -> Tile:
    """Return the highest share of a joint's limit that was commanded, or else measured."""
    told = analysis.commanded
    peaks = (getattr(told, kind) if told is not None
             else getattr(analysis.joints, f'peak_{kind}', None))
    title = f'Highest {kind}, {"commanded" if told is not None else "measured"}'
    if peaks is None or limits is None or not np.isfinite(limits).any():
        return Tile(title, None, '% of the limit')
    with np.errstate(divide='ignore', invalid='ignore'):
        shares = np.nan_to_num(peaks / limits)
    worst = int(shares.argmax())
    return Tile(title, 100.0 * float(shares[worst]), '% of the limit', 100.0,
                detail=analysis.joint_names[worst])


def _joint_paths(analysis: Analysis) -> list[Tile]:
    units = np.array(joint_units(analysis))
    titles = {'rad': 'Joint path, turning joints', 'm': 'Joint path, sliding joints'}
    return [Tile(titles.get(unit, 'Joint path'), float(analysis.joints.path[units == unit].sum()),
                 unit) for unit in dict.fromkeys(units.tolist())]


def tiles_html(names: Sequence[str], tiles: Sequence[Sequence[Tile]]) -> str:
    """Return the tiles of one or more bags as HTML, those of a kind side by side.

    Args:
        names: of the bags.
        tiles: of every bag.
    """
    shown = ''
    for title in dict.fromkeys(tile.title for of_bag in tiles for tile in of_bag):
        found = [next((tile for tile in of_bag if tile.title == title), None)
                 for of_bag in tiles]
        if any(tile is not None and tile.value is not None for tile in found):
            shown += _tile_html(title, names, found)
    return f'<ul class="tiles">{shown}</ul>'


def _tile_html(title: str, names: Sequence[str], tiles: Sequence[Tile | None]) -> str:
    verdicts = [tile.good for tile in tiles if tile is not None]
    kind = 'bad' if False in verdicts else 'good' if True in verdicts else 'open'
    body = ''
    for i, tile in enumerate(tiles):
        if tile is None or tile.value is None:
            body += f'<p class="value">{_key(i, names)}<span>not recorded</span></p>'
            continue
        body += (f'<p class="value">{_key(i, names)}<b>{number_text(tile.value)}</b> '
                 f'<span>{tile.unit}</span></p>'
                 f'<p class="verdict">{_verdict(tile)}</p>')
        if tile.detail:
            body += f'<p class="detail">{escape(tile.detail)}</p>'
    first = tiles[0]
    for i, other in enumerate(tiles[1:], 1):
        if (first is not None and other is not None and first.value is not None
                and other.value is not None):
            body += (f'<p class="difference">{chr(65 + i % 26)} − A: '
                     f'{difference_text(first.value, other.value)} {other.unit}</p>')
    return f'<li class="tile {kind}"><h3>{escape(title)}</h3>{body}</li>'


def _key(index: int, names: Sequence[str]) -> str:
    """Return the mark that stands for a bag, where there are several."""
    if len(names) == 1:
        return ''
    letter = chr(65 + index % 26)
    return f'<i class="key s{index % 6}" title="{escape(names[index])}">{letter}</i> '


def _verdict(tile: Tile) -> str:
    if tile.good is None or tile.limit is None:
        return 'no limit'
    side = 'at least' if tile.at_least else 'at most'
    # Spaces that do not part a number from its unit.
    limit = f'{side} {number_text(tile.limit)}\u00a0{tile.unit.split()[0]}'
    sign, word = ('✓', 'kept') if tile.good else ('✕', 'not kept')
    return f'<strong>{sign} {word}</strong> · {limit}'

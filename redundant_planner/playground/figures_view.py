"""The live figures of the page, as HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import html

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.model import Robot
from redundant_planner.playground.measures import NearestPair, Tally
from redundant_planner.playground.planner_client import Motion
from redundant_planner.playground.world import item_name

Array = npt.NDArray[np.float64]

# Above this share of a limit a bar warns, and above 1 it is over.
_CLOSE, _OVER = 0.85, 1.0005
# A distance below this is close [m].
_NEAR = 0.03
_STYLE = """<style>
.pg{font:11.5px/1.45 system-ui,sans-serif;font-variant-numeric:tabular-nums;padding:0 .6em .4em}
.pg table{border-collapse:collapse;width:100%}
.pg td,.pg th{padding:1px 3px;text-align:right;white-space:nowrap}
.pg td:first-child,.pg th:first-child{text-align:left}
.pg th{font-weight:600;opacity:.7}
.pg .bar{display:inline-block;width:34px;height:7px;border-radius:2px;background:#8883;
  vertical-align:middle;overflow:hidden}
.pg .bar i{display:block;height:100%;background:#3a7bd0}
.pg .bar i.close{background:#e09a2b}.pg .bar i.over{background:#d02a2a}
.pg .bad{color:#d02a2a;font-weight:600}.pg .close{color:#b36b00}
.pg .said{margin:.2em 0;min-height:2.9em;white-space:normal}
</style>"""


def figures_html(
    robot: Robot, motion: Motion, status: Mapping[str, str], near: NearestPair | None,
    target: Mapping[str, str],
) -> str:
    """Return the figures of one arm.

    Args:
        robot: the arm.
        motion: what it does.
        status: of the planner, see `PlannerClient`.
        near: the nearest pair.
        target: of the planner, see `PlannerClient`.
    """
    said = status.get('message', 'the planner is silent')
    rows = [
        ('nearest distance', _pair(near)),
        ('path followed, s', _share(status.get('twist scale s'))),
        ('stage', html.escape(status.get('stage', '–').lower())),
        ('off its path', _millimetres(status.get('path error [m]'))),
        ('manipulability', html.escape(status.get('manipulability', '–'))),
        ('tick, median / longest', f"{_microseconds(status, 'median')} / "
                                   f"{_microseconds(status, 'longest')}"),
        ('period, median / p99', _periods(motion)),
    ]
    if target:
        rows.insert(0, ('target', f"{html.escape(target['message'])}, "
                                  f"{_millimetres(target.get('distance [m]'))} left"))
    table = ''.join(f'<tr><td>{name}</td><td>{value}</td></tr>' for name, value in rows)
    return (f'{_STYLE}<div class="pg" data-figures><div class="said"><b>{html.escape(said)}</b>'
            f'</div><table>{table}</table>{_joints(robot, motion)}</div>')


def tallies_html(real: Tally, ghost: Tally, method: str) -> str:
    """Return joint paths and distances of the arm and of the ghost, side by side."""
    rows = [('joint path', *(f'{tally.path:.3f} rad' for tally in (real, ghost))),
            ('nearest distance', *(_distance(tally.distance) for tally in (real, ghost))),
            ('smallest distance', *(_distance(tally.smallest) for tally in (real, ghost)))]
    body = ''.join('<tr>' + ''.join(f'<td>{cell}</td>' for cell in row) + '</tr>' for row in rows)
    return (f'{_STYLE}<div class="pg" data-compare><table><tr><th></th><th>this arm</th>'
            f'<th>{html.escape(method.partition(":")[0])}</th></tr>{body}</table></div>')


def _joints(robot: Robot, motion: Motion) -> str:
    head = '<tr><th>joint</th><th>velocity</th><th></th><th>acceleration</th><th></th></tr>'
    rows = []
    for i, name in enumerate(robot.joint_names):
        cells = [html.escape(name)]
        for value, limit in ((motion.commanded[i], robot.velocity_max[i]),
                             (motion.accelerations[i], robot.acceleration_max[i])):
            cells += [f'{value:+.2f} / {limit:.2f}', _bar(abs(float(value)) / float(limit))]
        rows.append('<tr>' + ''.join(f'<td>{cell}</td>' for cell in cells) + '</tr>')
    return f'<table>{head}{"".join(rows)}</table><div>rad/s and rad/s²: as commanded / limit</div>'


def _bar(share: float) -> str:
    kind = 'over' if share > _OVER else 'close' if share > _CLOSE else ''
    return (f'<span class="bar"><i class="{kind}" style="width:{min(100.0 * share, 100.0):.0f}%">'
            '</i></span>')


def _pair(near: NearestPair | None) -> str:
    if near is None:
        return 'nothing is near'
    return (f'{_distance(near.distance)}<br>{html.escape(near.link)} to '
            f'{html.escape(item_name(near.obstacle))}')


def _distance(distance: float) -> str:
    if not np.isfinite(distance):
        return '–'
    kind = 'bad' if distance < 0.0 else 'close' if distance < _NEAR else ''
    return f'<span class="{kind}">{1e3 * distance:.0f} mm</span>'


def _number(text: str | None) -> float:
    try:
        return float(text or 'nan')
    except ValueError:
        return float('nan')


def _share(text: str | None) -> str:
    share = _number(text)
    return '–' if np.isnan(share) else f'{100.0 * share:.0f} %'


def _millimetres(text: str | None) -> str:
    metres = _number(text)
    return '–' if np.isnan(metres) else f'{1e3 * metres:.1f} mm'


def _microseconds(status: Mapping[str, str], which: str) -> str:
    return f"{html.escape(status.get(f'tick time, {which} [us]') or '–')} µs"


def _periods(motion: Motion) -> str:
    periods: Sequence[float] = list(motion.periods)
    if not periods:
        return '–'
    median, high = 1e3 * np.percentile(periods, (50, 99))
    return f'{median:.2f} / {high:.2f} ms'

"""Which benchmark answers which question, by which command, and what of its JSON is shown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from redundant_planner.core.target.progress import TargetState

LESS, MORE = 'less', 'more'


class Figure(NamedTuple):
    """A row of a table.

    Attributes:
        title: what it is, with its unit.
        better: `LESS` or `MORE`; empty where neither is better.
        values: of each column that has one.
    """

    title: str
    better: str
    values: Mapping[str, float]


class Question(NamedTuple):
    """A question and the benchmark that answers it.

    Attributes:
        name: of the JSON file.
        title: the question.
        module: of the benchmark.
        options: that a full run and a quick one share.
        full, quick: those that say how much is run.
        own: this package's methods that are asked for, empty where the benchmark chooses.
        peers: that can take part.
        peer_option: by which they are asked for, empty where the benchmark looks itself.
        figures: returns the rows of its JSON.
        remark: that a reader of the table has to know; empty for none.
    """

    name: str
    title: str
    module: str
    options: tuple[str, ...]
    full: tuple[str, ...]
    quick: tuple[str, ...]
    own: tuple[str, ...]
    peers: tuple[str, ...]
    peer_option: str
    figures: Callable[[Any], list[Figure]]
    remark: str = ''

    def command(self, peers: Sequence[str], *, quick: bool) -> tuple[str, ...]:
        """Return the arguments of the command, from `-m` on, beside those peers that can."""
        methods = [part for name in self.own for part in ('--method', name)]
        others = [part for name in self.peers if name in peers and self.peer_option
                  for part in (self.peer_option, name)]
        return ('-m', self.module, *self.options, *(self.quick if quick else self.full),
                *methods, *others)


class _Row(NamedTuple):
    """A figure as benchmarks have it: its key in the JSON, and how many of it make a unit."""

    key: str
    title: str
    better: str
    scale: float = 1.0


_SCENARIO = (
    _Row('collisions', 'collisions', LESS), _Row('unavoidable', 'of these unavoidable', ''),
    _Row('limit_violations', 'motions beyond a limit', LESS),
    _Row('tracked', 'kept to the path to its end [%]', MORE, 100.0),
    _Row('on_path_at_the_end', 'on the path at the end [%]', MORE, 100.0),
    _Row('max_path_error_mm', 'off the path, at most [mm]', LESS),
    _Row('min_distance_mm', 'smallest distance [mm]', ''),
    _Row('cost_median', '∫q̇ᵀq̇ dt, median [rad²/s]', LESS),
    _Row('path_median', 'joint path, median [rad]', LESS),
    _Row('reversals_median', 'reversals of acceleration, median', LESS),
    _Row('reversals_max', 'reversals of acceleration, most', LESS))
_OPTIMALITY = (
    _Row('median_ratio', '∫q̇ᵀq̇ dt over the least, median', LESS),
    _Row('p90_ratio', '∫q̇ᵀq̇ dt over the least, 90 % within', LESS),
    _Row('completed', 'kept to the path to its end [%]', MORE, 100.0))
_PROBLEMS = (
    _Row('reached', 'reached [%]', MORE, 100.0), _Row('collisions', 'collisions', LESS),
    _Row('self_collisions', 'collisions with itself', LESS),
    _Row('limit_violations', 'motions beyond a limit', LESS),
    _Row('total_median', 'thinking and motion, median [s]', LESS),
    _Row('path_median', 'joint path, median [rad]', LESS))
_SMOOTHNESS = (
    _Row('reversals_median', 'reversals of acceleration, median', LESS),
    _Row('reversals_max', 'reversals of acceleration, most', LESS),
    _Row('rms_acceleration', 'rms acceleration, median [rad/s²]', LESS),
    _Row('violations', 'motions beyond a limit', LESS),
    _Row('max_path_error_mm', 'off the path, at most [mm]', LESS))
_STREAMS = (
    _Row('lag_s', 'lag, median [ms]', LESS, 1e3), _Row('rms_mm', 'rms off the input [mm]', LESS),
    _Row('reversals_median', 'reversals, median', LESS),
    _Row('outlier_mm', 'off the input, at most [mm]', LESS),
    _Row('violations', 'motions beyond a limit', LESS))
THIS = 'this package'


def _by_method(rows: Sequence[_Row]) -> Callable[[dict[str, Any]], list[Figure]]:
    """Return the rows of a JSON with an entry for each method."""
    def figures(found: dict[str, Any], before: str = '') -> list[Figure]:
        return [Figure(before + row.title, row.better, {
            name: row.scale * float(entry[row.key]) for name, entry in found.items()
            if entry[row.key] is not None}) for row in rows]
    return figures


def _smoothness(found: dict[str, Any]) -> list[Figure]:
    return [figure._replace(title=f'{drive} arm: {figure.title}')
            for drive, entries in found.items() for figure in _by_method(_SMOOTHNESS)(entries)]


def _streams(found: dict[str, Any]) -> list[Figure]:
    """Return the rows of every input, whose peers' entries are named after it."""
    peers = ('mink', 'pink')
    inputs = [name for name in found if not name.endswith(peers)]
    return [figure._replace(title=f'{name}: {figure.title}')
            for name in inputs for figure in _by_method(_STREAMS)({
                column: found[key] for column, key in (
                    (THIS, name), *((peer, f'{name} {peer}') for peer in peers)) if key in found})]


def _speed(found: dict[str, Any]) -> list[Figure]:
    """Return the median times of a tick, a row for each number of obstacles."""
    columns = {'tick_us': 'dynamic_factor', 'variational_us': 'variational', 'mink_us': 'mink',
               'pink_us': 'pink', 'roboplan_us': 'roboplan', 'neo_us': 'neo',
               'cbfpy_us': 'cbfpy'}
    return [Figure(f'tick with {count} obstacles, median [µs]', LESS, {
        name: found[key][count] for key, name in columns.items() if count in found.get(key, {})})
        for count in found['tick_us']]


def _targets(found: dict[str, Any]) -> list[Figure]:
    reached = {name: [run for run in runs if run['state'] == TargetState.REACHED.value]
               for name, runs in found.items()}

    def median(key: Callable[[dict[str, Any]], float]) -> dict[str, float]:
        return {name: float(np.median([key(run) for run in runs]))
                for name, runs in reached.items() if runs}

    return [
        Figure('reached [%]', MORE, {
            name: 100.0 * len(reached[name]) / len(runs) for name, runs in found.items()}),
        Figure('contacts', LESS, {
            name: sum(run['clearance'] < 0.0 for run in runs) for name, runs in found.items()}),
        Figure('motions beyond a limit', LESS, {
            name: sum(run['violation'] > 0.0 for run in runs) for name, runs in found.items()}),
        Figure('sets off after, median [s]', LESS, median(lambda run: run['thought'])),
        Figure('arrives after, median [s]', LESS, median(lambda run: run['seconds'])),
        Figure('time over the least on the same path, median', LESS,
               median(lambda run: run['seconds'] / run['fastest'])),
        Figure('joint path, median [rad]', LESS, median(lambda run: run['path']))]


def _chunks(found: list[dict[str, Any]]) -> list[Figure]:
    kinds = {kind: [one for one in found if one['kind'] == kind]
             for kind in dict.fromkeys(one['kind'] for one in found)}

    def each(statistic: Callable[[list[float]], float], key: str, scale: float = 1.0) -> dict[
            str, float]:
        return {kind: scale * float(statistic([one[key] for one in runs]))
                for kind, runs in kinds.items() if all(key in one for one in runs)}

    return [
        Figure('runs', '', {kind: len(runs) for kind, runs in kinds.items()}),
        Figure('contacts', '', {
            kind: sum(one.get('clearance_m', 0.0) < 0.0 for one in runs)
            for kind, runs in kinds.items()}),
        Figure('motions beyond a limit', '', {
            kind: sum(one['violation'] > 0.0 for one in runs) for kind, runs in kinds.items()}),
        Figure('smallest distance [mm]', '', each(min, 'clearance_m', 1e3)),
        Figure('off the chunk, at most [mrad]', '', each(max, 'off_rad', 1e3)),
        Figure('behind it, at most [s]', '', each(max, 'behind_s')),
        Figure('time over that of the chunk, median', '', each(np.median, 'time_ratio')),
        Figure('reversals in 10 s, median', '', each(np.median, 'reversals_per_10_s'))]


def _two_arms(found: list[dict[str, Any]]) -> list[Figure]:
    arrived = [run for run in found if set(run['states']) == {TargetState.REACHED.value}]
    rows = [
        Figure('both arrive [%]', MORE, {THIS: 100.0 * len(arrived) / len(found)}),
        Figure('contacts', LESS, {THIS: sum(run['clearance'] < 0.0 for run in found)}),
        Figure('motions beyond a limit', LESS, {
            THIS: sum(run['violation'] > 0.0 for run in found)}),
        Figure('smallest distance [mm]', '', {
            THIS: 1e3 * min(run['clearance'] for run in found)})]
    if arrived:
        rows.append(Figure('both are there after, median [s]', LESS, {
            THIS: float(np.median([max(run['seconds']) for run in arrived]))}))
    return rows


_OWN = ('dynamic_factor', 'variational_known', 'variational_held')
QUESTIONS = (
    Question('scenarios', 'Does it hit something? Does it stay on its path?',
             'benchmark.scenarios', ('--seed', '97000'), ('--count', '200'), ('--count', '4'),
             _OWN, ('mink', 'pink', 'roboplan', 'neo'), '--method', _by_method(_SCENARIO),
             'Who leaves the path may move the joints less, and who is slowed down does.'),
    Question('moving', 'Does it hit what moves?', 'benchmark.scenarios',
             ('--moving', '--seed', '60000'), ('--count', '40'), ('--count', '1'),
             ('dynamic_factor',), ('mink', 'pink', 'neo'), '--method', _by_method(_SCENARIO),
             'Who is run over leaves the path less.'),
    Question('optimality', 'How far is it from the shortest joint path?', 'benchmark.optimality',
             ('--seed', '9000'), ('--count', '30'), ('--count', '2'), (), (), '',
             _by_method(_OPTIMALITY)),
    Question('targets', 'How does it get to a pose?', 'benchmark.targets', ('--seed', '0'),
             ('--count', '200'), ('--count', '20', '--jobs', '1'), ('dynamic_factor',), (), '',
             _targets),
    Question('problem_sets', 'How does it get to a pose among furniture?',
             'benchmark.problem_sets', ('--generated', '--command', 'target_pose'),
             ('--count', '100'), ('--count', '1', '--family', 'table'), ('dynamic_factor',),
             ('mink', 'pink'), '--method', _by_method(_PROBLEMS)),
    Question('streams', 'How does it follow a stream of poses?', 'benchmark.streams', (),
             ('--count', '20', '--seed', '1'),
             ('--count', '1', '--input', '72 Hz noise', '--input', '10 Hz'),
             (), ('mink', 'pink'), '--peer', _streams),
    Question('chunks', 'How does it follow chunks?', 'benchmark.chunks', ('--seed', '1'),
             ('--count', '100', '--policies', '30'), ('--count', '4', '--policies', '2'), (), (),
             '', _chunks),
    Question('smoothness', 'How smooth is it?', 'benchmark.smoothness', ('--seed', '52000'),
             ('--count', '30'), ('--count', '2', '--drive', 'ideal'), _OWN, ('mink', 'pink'),
             '--method', _smoothness),
    Question('speed', 'How long does a tick take?', 'benchmark.speed',
             ('--counts', '1', '3', '10', '100'), (), ('--ticks', '300'), (),
             ('mink', 'pink', 'roboplan', 'neo', 'cbfpy'), '', _speed),
    Question('two_arms', 'Do two arms get past each other?', 'benchmark.two_arms',
             ('--seed', '0'), ('--count', '100'), ('--count', '3', '--jobs', '1'), (), (), '',
             _two_arms))

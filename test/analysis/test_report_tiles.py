"""A tile tells a figure that keeps its limit from one that does not."""

from __future__ import annotations

from dataclasses import replace

from bags import paper_motion, write
import numpy as np
import pytest

from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.commanded import CommandPeaks
from redundant_planner.analysis.measure_tables import motion_measures
from redundant_planner.analysis.metrics import Periods
from redundant_planner.analysis.report_numbers import difference_text, number_text, share_text
from redundant_planner.analysis.report_tiles import Tile, tiles_html, tiles_of


@pytest.fixture(scope='module')
def found(tmp_path_factory):
    robot, parameters, motion = paper_motion(1.0)
    whole = analyse(write(tmp_path_factory.mktemp('tiles') / 'motion', robot, parameters, motion))
    period = whole.facts.period
    return replace(whole, facts=replace(whole.facts, tick_median=0.1 * period,
                                        tick_longest=0.5 * period))


def tile(analysis, title):
    return next(one for one in tiles_of(analysis) if one.title.startswith(title))


def with_peaks(found, **shares):
    """The same motion, with the last joint commanded to shares of its limits."""
    peaks = {}
    for kind in ('velocity', 'acceleration', 'jerk'):
        peaks[kind] = getattr(found.commanded, kind).copy()
        if kind in shares:
            peaks[kind][-1] = shares[kind] * getattr(found.robot, f'{kind}_max')[-1]
    return replace(found, commanded=CommandPeaks(**peaks))


WITHIN_AND_BEYOND = {
    'Smallest distance': lambda found, share: replace(
        found, distance=found.facts.margin * (2.0 - share)),
    'Tip off its path': lambda found, share: replace(found, curves=replace(
        found.curves, path_error=np.full(len(found.curves.times), 1e-3 * share))),
    'Highest velocity': lambda found, share: with_peaks(found, velocity=share),
    'Highest acceleration': lambda found, share: with_peaks(found, acceleration=share),
    'Longest tick': lambda found, share: replace(
        found, facts=replace(found.facts, tick_longest=share * found.facts.period)),
    'Command period': lambda found, share: replace(found, periods=Periods(
        found.facts.period, 1.5 * share * found.facts.period, 1.0))}


@pytest.mark.parametrize('title', WITHIN_AND_BEYOND)
def test_it_turns_bad_beyond_the_limit(found, title):
    change = WITHIN_AND_BEYOND[title]
    assert tile(change(found, 1.0), title).good is True
    bad = tile(change(found, 1.02), title)
    assert bad.good is False
    # By a sign and a word, and not by colour alone.
    page = tiles_html(['bag'], [[bad]])
    assert '✕ not kept' in page and 'class="tile bad"' in page
    page = tiles_html(['bag'], [[tile(change(found, 0.9), title)]])
    assert '✓ kept' in page and 'bad' not in page


def test_the_values_are_those_of_the_analysis(found):
    measures = motion_measures(found)
    assert tile(found, 'Smallest distance').value == measures['smallest_distance_mm']
    assert tile(found, 'Smallest distance').limit == pytest.approx(10.0)
    assert tile(found, 'Tip off').value == measures['largest_path_error_mm']
    sliding, turning = tile(found, 'Joint path, sliding'), tile(found, 'Joint path, turning')
    assert (sliding.unit, turning.unit) == ('m', 'rad')
    assert sliding.value == pytest.approx(found.joints.path[:2].sum())
    assert turning.value == pytest.approx(found.joints.path[2:].sum())
    share = (found.commanded.velocity / found.robot.velocity_max).max()
    assert tile(found, 'Highest velocity').value == pytest.approx(100.0 * share)


def test_without_a_robot_nothing_is_said_about_its_limits(found):
    alone = replace(found, robot=None, clearance=None, distance=np.inf)
    assert all(one.good is None for one in tiles_of(alone) if one.title.startswith('Highest'))
    assert tile(alone, 'Joint path').unit == 'rad or m'
    assert 'Highest' not in tiles_html(['bag'], [tiles_of(alone)])


def test_a_value_that_is_not_known_is_neither_good_nor_bad():
    assert Tile('', None, 'mm', 1.0).good is None
    assert Tile('', 1.0, 'mm').good is None


def test_names_in_a_tile_are_text():
    page = tiles_html(['<b>', '"><i>'], [[Tile('<b>', 1.0, 'mm', detail='<b>')]] * 2)
    assert '<b>1' in page and page.count('&lt;b&gt;') >= 3 and '"><i>' not in page


@pytest.mark.parametrize(('value', 'text'), [
    (0.0, '0'), (1e-9, '0'), (0.012345, '0.0123'), (-1.5, '−1.50'), (99.96, '100'),
    (12345.6, '12300'), (None, '–'), (np.nan, '–'), (np.inf, '–'), (2.5e-5, '2.50·10⁻⁵'),
    (1.234e20, '1.23·10²⁰')])
def test_numbers_have_three_digits_that_count(value, text):
    assert number_text(value) == text


def test_differences():
    assert difference_text(1.0, 0.5) == '−0.500' and difference_text(0.5, 1.0) == '+0.500'
    assert difference_text(1.0, 1.0) == '±0' and difference_text(np.inf, 1.0) == '–'
    assert share_text(2.0, 1.0) == '−50.0' and share_text(0.0, 1.0) == '–'
    assert share_text(1.0, 0.9999) == '±0'

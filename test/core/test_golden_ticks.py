"""Commands are those that were recorded: see benchmark/golden_ticks.py."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark import golden_ticks
from redundant_planner.core.parameters import METHODS, PAPER_METHODS
from redundant_planner.core.safety.stage import Stage

RECORDED = golden_ticks.read(golden_ticks.FILE)
# Other processors round otherwise, and what rounds otherwise grows a little [rad/s, m/s].
ROUND_OFF = 1e-6


@pytest.fixture(scope='module')
def scenes():
    return golden_ticks.scenes()


@pytest.mark.parametrize('name', RECORDED)
def test_commands_are_the_recorded_ones(scenes, name):
    recorded = RECORDED[name]
    ticks = golden_ticks.played(scenes[name], recorded.dq)
    certain = slice(recorded.certain)
    off = np.abs(ticks.dq - recorded.dq).max(axis=1)[certain]
    assert off.max() < ROUND_OFF, f'from tick {int(np.argmax(off > ROUND_OFF))} on'
    np.testing.assert_array_equal(ticks.stages[certain], recorded.stages[certain])


def test_most_of_what_is_recorded_does_not_depend_on_rounding():
    lengths = [len(recorded.dq) for recorded in RECORDED.values()]
    assert sum(recorded.certain for recorded in RECORDED.values()) > 0.9 * sum(lengths)
    assert min(recorded.certain for recorded in RECORDED.values()) > 10


def test_every_method_and_stage_is_there(scenes):
    methods = {scene.parameters.get('method', 'dynamic_factor') for scene in scenes.values()}
    assert methods == {*METHODS, *PAPER_METHODS}
    found = {int(stage) for ticks in RECORDED.values() for stage in np.unique(ticks.stages)}
    # Nothing stops for want of a solution unless the solver fails.
    assert {golden_ticks.STAGES[place] for place in found} == set(Stage) - {Stage.STOPPED}
    assert RECORDED.keys() == scenes.keys()

"""When simulated time goes on."""

from __future__ import annotations

import pytest

from redundant_planner.nodes.lock_step import LockStep

PERIOD = 0.004


def test_without_anybody_it_goes_on_at_its_real_pace():
    steps = LockStep(PERIOD, 0.0, 0.5)
    steps.begin(10.0)
    assert not steps.is_due(10.003) and steps.is_due(10.0041)
    # Looked at too late, it catches up by less than a period.
    steps.begin(10.006)
    assert not steps.is_due(10.0079) and steps.is_due(10.0081)
    steps.begin(11.0)
    assert steps.is_due(11.0001)
    steps.begin(11.0001)
    assert not steps.is_due(11.0039) and steps.is_due(11.0041) and not steps.missed


def test_it_waits_for_an_answer_and_then_goes_on_at_once():
    steps = LockStep(PERIOD, 0.0, 0.5)
    steps.begin(0.0)
    steps.answer('planner')
    assert steps.is_due(0.0)
    steps.begin(0.0)
    assert not steps.is_due(0.4)
    steps.answer('planner')
    assert steps.is_due(0.4) and steps.missed == 0


def test_it_does_not_wait_for_ever():
    steps = LockStep(PERIOD, 0.0, 0.5)
    steps.begin(0.0)
    steps.answer('planner')
    steps.begin(0.0)
    assert not steps.is_due(0.49) and steps.is_due(0.51)
    assert steps.missed == 1 and not steps.in_step
    steps.begin(0.51)
    assert steps.is_due(0.52)  # at its real pace again


def test_it_waits_for_all_who_have_answered_before():
    steps = LockStep(PERIOD, 0.0, 0.5)
    steps.begin(0.0)
    steps.answer('planner')
    steps.answer('operator')
    steps.begin(0.0)
    steps.answer('planner')
    assert not steps.is_due(0.1)
    assert steps.is_due(0.6) and steps.in_step == {'planner'}
    steps.begin(0.6)
    steps.answer('planner')
    assert steps.is_due(0.6)


@pytest.mark.parametrize('factor', [0.5, 2.0])
def test_it_is_no_faster_than_asked_for(factor):
    steps = LockStep(PERIOD, factor, 0.5)
    now, begun = 0.0, 0
    for _ in range(10_000):
        steps.answer('planner')
        if steps.is_due(now):
            steps.begin(now)
            begun += 1
        now += 1e-4
    assert begun == pytest.approx(now * factor / PERIOD, rel=0.01)

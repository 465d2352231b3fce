"""Messages on obstacles wait where they would delay a tick, and not for long."""

from __future__ import annotations

from types import SimpleNamespace

from hypothesis import given, strategies as st
import pytest

from redundant_planner.nodes.guard import Guard
from redundant_planner.nodes.obstacle_input import ObstacleInput

PERIOD = 0.004


@pytest.fixture(scope='module')
def make_input():
    nowhere = SimpleNamespace(update=lambda raw, now, topic: [])
    return lambda: ObstacleInput(['obstacles'], nowhere, PERIOD, Guard(pytest.fail), pytest.fail)


@given(st.lists(st.tuples(st.booleans(), st.floats(-1.0, 2.0)), max_size=50),
       st.floats(0.0, 2.0))
def test_no_message_is_put_off_more_than_twice(make_input, ticks, took):
    """Nor is any that fits in, nor one that would delay a tick at any time."""
    queue = make_input()
    queue.took = took * PERIOD
    times, waiting = 0, False
    for comes, left in ticks:
        if comes and not waiting:
            queue.on_message(b'')
            waiting = True
        if queue.put_off(left * PERIOD):
            times += 1
            assert waiting and times <= 2
            assert left < took < 1.0
            continue
        assert not waiting or times == 2 or left >= took or took >= 1.0
        queue.read(0.0)
        times, waiting = 0, False

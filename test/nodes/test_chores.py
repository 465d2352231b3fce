"""Chores: one after each tick at most, none forgotten, and none in the way of other work."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.nodes.chores import Chores
from redundant_planner.nodes.guard import Guard

TICK = 0.004


def done_at(busy, seconds=2.0, periods=(0.2, 0.05)):
    """Do chores of these periods after ticks; return when each of them was done [s]."""
    chores, done, now = Chores(Guard(pytest.fail)), [[] for _ in periods], 0.0
    for period, times in zip(periods, done):
        chores.add(period, lambda times=times: times.append(now))
    for i in range(round(seconds / TICK)):
        now = i * TICK
        before = sum(map(len, done))
        chores.do_one(now, busy(i))
        assert sum(map(len, done)) <= before + 1
    return [np.array(times) for times in done]


def test_each_has_its_period():
    for times, period in zip(done_at(lambda i: False), (0.2, 0.05)):
        assert len(times) == pytest.approx(2.0 / period, abs=2.0)
        assert np.diff(times).max() < period + 3.0 * TICK


def test_they_wait_for_a_tick_with_nothing_else_to_do():
    for times in done_at(lambda i: i % 3 > 0):
        assert (np.round(times / TICK) % 3 == 0).all()


def test_where_every_tick_has_other_work_they_do_not_wait_for_long():
    for times, period in zip(done_at(lambda i: True), (0.2, 0.05)):
        assert period < np.diff(times).max() < period + 0.03


def test_a_clock_that_is_set_back_does_not_stop_them():
    chores, done = Chores(Guard(pytest.fail)), []
    chores.add(0.2, lambda: done.append(True))
    for now in (100.0, 50.0, 50.1, 50.21):
        chores.do_one(now)
    assert len(done) == 3

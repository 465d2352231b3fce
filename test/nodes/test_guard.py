"""An exception is counted, and logged now and then."""

from __future__ import annotations

import numpy as np

from redundant_planner.nodes.command_pacer import CommandPacer
from redundant_planner.nodes.guard import Guard, line_of


def test_each_exception_counts_and_each_place_is_heard_once_a_second():
    said = []
    guard = Guard(said.append)
    for _ in range(100):
        assert guard.call('here', lambda: 1 / 0) is None
        assert guard.call('there', lambda: [][1]) is None
    assert guard.call('here', lambda: 3) == 3
    assert guard.count == 200 and guard.last == 'there: IndexError: list index out of range'
    assert len(said) == 2 and 'ZeroDivisionError' in said[0] and 'Traceback' in said[0]


def test_an_exception_of_several_lines_is_one_line():
    assert line_of(ValueError('one\n  two')) == 'ValueError: one two'


def test_a_tick_is_due_a_period_after_the_last_one_and_not_before_the_first():
    beat = CommandPacer(0.004)
    assert not beat.is_due(1e9)
    for begin in 0.004 * np.arange(1000):
        beat.begin(begin)
        assert not beat.is_due(begin + 0.00399)
        assert beat.is_due(begin + 0.00401)

"""An arm with wrapped joints under every kind of command, live, as `benchmark.seams` drives it."""

from __future__ import annotations

from forked_nodes import ForkedProcesses
from live_helpers import LIVE
import numpy as np
import pytest
from ros_domains import next_domain

from benchmark.seams import crossings, run
from redundant_planner.io.joint_turns import wrapped

pytestmark = LIVE


@pytest.mark.long
def test_a_wrapped_arm_crosses_its_seams_under_every_kind_of_command(tmp_path):
    outcome = run(tmp_path, 1.0, next_domain(), ForkedProcesses)
    assert not outcome.problems
    assert set(outcome.segments.values()) == {1} and len(outcome.segments) == 5
    assert len(outcome.crossings) == 3 and min(outcome.crossings.values()) >= 8
    assert outcome.ticks > 1000


def test_crossings_are_counted_without_those_of_noise():
    t = np.linspace(0.0, 1.0, 1000)
    noise = np.random.default_rng(0).normal(0.0, 1e-4, len(t))
    free = np.full(1, np.inf)

    def seen(q):
        return np.concatenate([wrapped(np.array([each]), free) for each in q + noise])

    assert crossings(seen(np.full(len(t), np.pi))) == 0
    assert crossings(seen(np.pi + 0.3 * np.sin(2.0 * np.pi * 3.0 * t))) == 5
    assert crossings(seen(20.0 * t)) == 3
    assert crossings(seen(-20.0 * t)) == 3

"""Selection agrees with sorting."""

from __future__ import annotations

from hypothesis import given, strategies as st
import numpy as np

from redundant_planner.core.obstacles.selection import kth_smallest

# Few different ones, so that many are equal.
_values = st.one_of(
    st.floats(), st.integers(-3, 3).map(float), st.sampled_from([np.inf, -np.inf, np.nan]))


@given(st.lists(_values, min_size=1, max_size=60).map(np.array), st.data())
def test_selects_what_sorting_puts_there_and_leaves_the_values(values, data):
    k = data.draw(st.integers(0, len(values) - 1))
    before = values.copy()
    found = kth_smallest(values, k)
    assert found == np.sort(np.where(np.isnan(values), np.inf, values))[k]
    # Those who choose with it make room for no more.
    assert np.count_nonzero(values < found) <= k
    np.testing.assert_array_equal(values, before)


def test_selects_among_many():
    rng = np.random.default_rng(1)
    for values in (np.arange(9000.0), np.arange(9000.0)[::-1], rng.normal(size=9001)):
        for k in (0, 1, 119, 4500, len(values) - 1):
            assert kth_smallest(values, k) == np.sort(values)[k]

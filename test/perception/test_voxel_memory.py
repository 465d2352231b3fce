"""A voxel stays until clouds show that it is free, or have not shown it for long enough."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.perception.voxel_memory import VoxelMemory


def nobody(keys):
    return np.zeros(len(keys), bool), np.zeros(len(keys), bool)


def having(free=(), beyond=()):
    return lambda keys: (np.isin(keys, free), np.isin(keys, beyond))


def update(memory, seen, stamp, judge=nobody, persistence=1.0):
    memory.update(np.array(seen, np.intp), stamp, persistence, judge)
    assert (np.diff(memory.keys) > 0).all() and len(memory.keys) == len(memory.seen_at)
    return memory.keys.tolist()


def test_an_unseen_voxel_stays_for_as_long_as_it_may():
    memory = VoxelMemory()
    assert update(memory, [5, 3, 9], 10.0) == [3, 5, 9]
    assert update(memory, [5, 7], 10.5) == [3, 5, 7, 9]
    assert update(memory, [], 11.0) == [3, 5, 7, 9]
    assert update(memory, [], 11.001) == [5, 7]
    assert update(memory, [7], 11.5) == [5, 7]
    assert update(memory, [], 11.6) == [7]
    assert update(memory, [], 12.6) == []


def test_what_is_free_goes_at_once_and_what_nobody_can_judge_does_not_age():
    memory = VoxelMemory()
    update(memory, [1, 2, 3], 0.0)
    assert update(memory, [], 0.1, having(free=[2])) == [1, 3]
    for stamp in np.arange(1.0, 9.0, 0.9):
        assert 3 in update(memory, [], stamp, having(beyond=[3]))
    assert update(memory, [], 9.0, having(free=[3], beyond=[3])) == []
    assert update(memory, [3], 9.1, having(free=[3])) == [3]  # a cloud that shows it wins


def test_only_unseen_voxels_are_judged():
    memory, asked = VoxelMemory(), []

    def judge(keys):
        asked.append(keys.tolist())
        return nobody(keys)

    update(memory, [1, 2, 3], 0.0, judge)
    update(memory, [2, 4], 0.1, judge)
    assert asked == [[], [1, 3]]


@pytest.mark.parametrize('late', [0.0, 0.1, 0.9])
def test_clouds_of_two_cameras_may_come_out_of_order(late):
    memory = VoxelMemory()
    update(memory, [1], 10.0)
    assert update(memory, [2], 10.0 - late) == [1, 2]
    assert update(memory, [], 11.0) == [1, 2] and update(memory, [], 11.1) == []


def test_a_clock_that_is_set_back_keeps_nothing_for_ever():
    memory = VoxelMemory()
    update(memory, [1], 1000.0)
    assert update(memory, [2], 5.0) == [1, 2]
    assert update(memory, [2], 6.1) == [2]


def test_a_memory_can_be_told_to_forget():
    memory = VoxelMemory()
    update(memory, [1, 2, 3], 0.0)
    memory.keep(np.array([True, False, True]))
    assert memory.keys.tolist() == [1, 3]
    memory.clear()
    assert update(memory, [7], -5.0) == [7]

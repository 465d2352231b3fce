"""Tries Numba's insides on three small functions: importing this module compiles them.

They do what all others do: they borrow, return what they borrowed, cross over packed and taken
apart, and call each other by name.
"""

from __future__ import annotations

from functools import partial
import sys
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.machine_code.compiling import (
    compile_called,
    compile_entry,
    compile_inlined,
)
from redundant_planner.core.machine_code.numba_internals import INTERNALS, named_alike
from redundant_planner.core.machine_code.packed import Packed

Vector = npt.NDArray[np.float64]
Matrix = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


class _Grid(NamedTuple):
    """Numbers of every kind that records hold."""

    values: Matrix
    rows: Indices
    factor: float


class _Answer(NamedTuple):
    """What is borrowed, and what is new."""

    kept: Vector
    sums: Vector


@partial(compile_inlined, means=INTERNALS)
def _sum(values: Vector) -> float:
    """Return the sum of some numbers."""
    total = 0.0
    for value in values:
        total += value
    return total


@partial(compile_called, means=INTERNALS)
def _answer(grid: _Grid, plain: Vector) -> _Answer:
    """Return an argument and sums of another."""
    sums = np.empty(len(grid.rows))
    for i in range(len(sums)):
        sums[i] = grid.factor * _sum(grid.values[grid.rows[i]])
    return _Answer(plain, sums)


@partial(compile_entry, means=INTERNALS)
def _entered(packed: Packed[_Grid], grid: _Grid, plain: Vector) -> _Answer:
    """Return an argument and differences of sums."""
    first = _answer(packed.value, plain)
    second = _answer(grid, plain)
    for i in range(len(first.sums)):
        first.sums[i] -= second.sums[i]
    return first


def check() -> None:
    """Raise an error if the three functions do not do as they should."""
    if not named_alike(_answer):
        raise ArithmeticError('its machine code bears other names')
    values, plain = np.arange(12.0).reshape(3, 4), np.arange(3.0)
    grid = _Grid(values, np.array([2, 0]), 1.0)
    packed = Packed.of(grid._replace(factor=2.0))
    arrays = (values, grid.rows, plain, packed.numbers, packed.integers)
    before = [sys.getrefcount(array) for array in arrays]
    for _ in range(3):
        found = _entered(packed, grid, plain)
        if not (np.array_equal(found.kept, plain) and np.array_equal(found.sums, [38.0, 6.0])):
            raise ArithmeticError('its machine code computes something else')
        if np.shares_memory(found.kept, plain):
            raise ArithmeticError('its machine code returns what it has borrowed')
    if [sys.getrefcount(array) for array in arrays] != before:
        raise ArithmeticError('its machine code counts references to what it has borrowed')

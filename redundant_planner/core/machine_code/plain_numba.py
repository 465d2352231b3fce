"""The means of a Numba whose insides nobody has tried: only what its documentation promises.

Numba counts references to all arrays, and compiles each function again into those that call it.
The results are the same.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

from numba import types
from numba.extending import overload

from redundant_planner.core.machine_code.means import entrywise, Means


def _borrowed(value: Any) -> Any:
    """Return an argument as it is."""
    return value


def _owned(value: Any) -> Any:
    """Return what may be returned: all arrays as copies, for each might be an argument's."""
    return value


def _part(array: Any, start: int, shape: tuple[int, ...]) -> Any:
    """Return a part of an array (k,), from an entry on, as an array of another shape."""
    size = 1
    for length in shape:
        size *= length
    return array[start:start + size].reshape(shape)


@overload(_borrowed, strict=False)  # type: ignore[untyped-decorator]
def _borrowed_compiled(value: types.Type) -> Any:
    return lambda value: value


@overload(_owned, strict=False)  # type: ignore[untyped-decorator]
def _owned_compiled(value: types.Type) -> Any:
    if isinstance(value, types.Array):
        return lambda value: value.copy()
    return entrywise(_owned, value)


@overload(_part, strict=False)  # type: ignore[untyped-decorator]
def _part_compiled(array: types.Type, start: types.Type, shape: types.Type) -> Any:
    return _part


PLAIN = Means(
    folder='-plain', called={}, inlined={},
    ownership={'borrowed': _borrowed, 'borrowed_part': _part, 'owned': _owned},
    naming=lambda function: nullcontext(), share=lambda dispatcher: None)

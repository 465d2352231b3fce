"""What stays in place from tick to tick, in two arrays that machine code takes over at once.

Numba takes 50 ns to take an array over from Python, and 20 ns a number. A robot and its
parameters are 20 of each.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar
import zlib

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Value = TypeVar('Value')


@dataclass(frozen=True)
class Packed(Generic[Value]):
    """A NamedTuple whose arrays are views of one array of floats and one of whole numbers.

    The latter begins with a number that tells what is in it (`layout_of`), and where each array
    or number begins, followed by the array's shape. An `entry` takes only the two arrays over,
    and makes the NamedTuple of them again.

    Attributes:
        value: the NamedTuple; what machine code writes to its arrays shows in it.
        numbers, integers: all that is in it.
    """

    value: Value
    numbers: npt.NDArray[np.float64]
    integers: npt.NDArray[np.intp]

    @classmethod
    def of(cls, value: Value) -> Packed[Value]:
        """Copy a NamedTuple of arrays of floats or whole numbers, numbers, and others like it."""
        entries = [np.asarray(entry) for entry in _entries(value)]
        header = [layout_of((entry.dtype == np.float64, entry.ndim) for entry in entries)]
        parts: dict[bool, list[Array]] = {True: [], False: []}
        length = {True: 0, False: 1 + sum(1 + entry.ndim for entry in entries)}
        for entry in entries:
            floats = entry.dtype == np.float64
            header += [length[floats], *entry.shape]
            parts[floats].append(entry.ravel())
            length[floats] += entry.size
        numbers = np.concatenate([np.empty(0), *parts[True]])
        integers = np.concatenate([header, *parts[False]]).astype(np.intp)
        starts, views = 1, []
        for entry in entries:
            whole = numbers if entry.dtype == np.float64 else integers
            at = integers[starts]
            views.append(whole[at:at + entry.size].reshape(entry.shape))
            starts += 1 + entry.ndim
        return cls(_with_arrays(value, iter(views)), numbers, integers)


def layout_of(entries: Iterable[tuple[bool, int]]) -> int:
    """Return a checksum of what is packed, by which a record is told from others.

    Args:
        entries: of each whether it is of floats, and how many dimensions it has.
    """
    return zlib.crc32(repr([(bool(floats), ndim) for floats, ndim in entries]).encode())


def _entries(value: Any) -> Iterator[Any]:
    """Yield the arrays and numbers of a NamedTuple, those of NamedTuples within it among them."""
    for entry in value:
        if isinstance(entry, tuple):
            yield from _entries(entry)
        else:
            yield entry


def _with_arrays(value: Any, views: Iterator[Array]) -> Any:
    """Return a NamedTuple with views in place of its arrays; its numbers stay as they are.

    Args:
        value: the NamedTuple.
        views: one for each array and each number, in the order of `_entries`.
    """
    made = []
    for entry in value:
        if isinstance(entry, tuple):
            made.append(_with_arrays(entry, views))
        else:
            view = next(views)
            made.append(view if isinstance(entry, np.ndarray) else entry)
    return type(value)(*made)

"""Machine code for what runs in every tick (Numba).

A tick is some thousand additions and multiplications on arrays of a few numbers. NumPy takes a
microsecond for each call on them; compiled, all of them together take little more. The functions
that are marked here are plain Python, compiled when their module is first imported. The machine
code is kept, so later starts only load it. `NUMBA_DISABLE_JIT=1` runs the same code as Python,
for a debugger.

Argument types come from the annotations, once: a type that only turned up later would stop the
control loop while it is being compiled. A wrong one is a TypeError instead.

An array that Python makes and a function fills takes 0.15 µs, one that a function returns 0.35 µs.
So what runs in every tick fills its results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import itertools
from pathlib import Path
import sys
from typing import Any, cast, TypeVar
import zlib

import numba
from numba import types
from numba.core.bytecode import FunctionIdentity
import numpy as np
import numpy.typing as npt

from redundant_planner.core.machine_code.argument_types import argument_types, LOCAL
from redundant_planner.core.machine_code.crossing import (
    borrowing,
    crossings,
    handing_over,
    taking_parts,
)
from redundant_planner.core.machine_code_cache import machine_code_folder, seal

# Arrays of 1, 2, 3 and 4 dimensions. As arguments in any order and read-only or not; as fields
# of a NamedTuple C-ordered and writeable.
Vector = npt.NDArray[np.float64]
Matrix = npt.NDArray[np.float64]
Stack = npt.NDArray[np.float64]
Stacks = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
IndexPairs = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]  # of 2 dimensions
# Arguments that the function fills.
OutVector = npt.NDArray[np.float64]
OutMatrix = npt.NDArray[np.float64]
OutStack = npt.NDArray[np.float64]

_Function = TypeVar('_Function', bound=Callable[..., object])


def compiled(function: _Function) -> _Function:
    """Compile a function for the argument types that its annotations name.

    They are the names above, float, int, bool, and NamedTuples of these. It borrows its arguments
    (`borrowed_arrays`): those that it returns are copies. Division by zero gives infinity or NaN,
    as in NumPy.
    """
    if numba.config.DISABLE_JIT:
        return function
    return _compile(borrowing(function), argument_types(function), {})


def kernel(function: _Function) -> _Function:
    """Compile a function, as `compiled`, into those that call it: only compiled functions can.

    A call of its own would copy the descriptions of all arrays in its arguments and count
    references to them. With the records of a scene that takes 150 ns, more than most functions
    here compute for.
    """
    return _compile(
        function, argument_types(function), {'no_cpython_wrapper': True, 'forceinline': True})


def entry(function: _Function) -> _Function:
    """Compile a function, as `compiled`, that only Python calls, in every tick.

    Numba takes arrays and numbers over from Python in half the time that NamedTuples of them
    need. All NamedTuples are therefore taken apart on the one side and put together on the
    other. They may be arguments, the result, and fields of either. What is `Packed` crosses over
    in its two arrays.
    """
    if numba.config.DISABLE_JIT:
        return function
    arguments = crossings(function)
    kinds = itertools.chain(*(argument.kinds for argument in arguments))
    inner = _compile(taking_parts(function, arguments), tuple(kinds), {})
    return cast(_Function, handing_over(function, arguments, inner))


def _compile(
    function: _Function, arguments: tuple[types.Type, ...], options: dict[str, bool],
) -> _Function:
    if numba.config.DISABLE_JIT:
        return function
    with _keeping() as kept, _named_alike_everywhere(function):
        dispatcher = numba.njit(
            arguments, cache=kept, error_model='numpy', no_cfunc_wrapper=True, **options,
        )(function)
    if 'forceinline' not in options and LOCAL not in function.__qualname__:
        _share(dispatcher)
    if dispatcher.stats.cache_misses:
        _say_once()
        if kept:
            seal(Path(dispatcher.stats.cache_path), f'.{function.__qualname__}-')
    return dispatcher


@contextmanager
def _named_alike_everywhere(function: Callable[..., object]) -> Iterator[None]:
    """Have a function's machine code bear the same name in all processes that compile it.

    Numba's names end in a number that counts up: what is compiled here would not find what
    another process compiled and kept. Functions within functions keep such numbers: those of one
    name need not be the same.
    """
    if LOCAL in function.__qualname__:
        yield
        return
    before = FunctionIdentity._unique_ids
    name = f'{function.__module__}.{function.__qualname__}'
    FunctionIdentity._unique_ids = itertools.count(zlib.crc32(name.encode()) << 16)
    try:
        yield
    finally:
        FunctionIdentity._unique_ids = before


def _share(dispatcher: Any) -> None:
    """Have compiled functions call this one by its name.

    Numba would compile it again into each of them, and with it all that it calls: a quarter more
    work, for ticks that are no faster.
    """
    for version in dispatcher.overloads.values():
        context, function = version.target_context, version.entry_point
        context.remove_user_function(function)
        context.insert_user_function(function, version.fndesc)


def _say_once() -> None:
    if not _told:
        _told.append(True)
        print('redundant_planner: compiling its mathematics, once per installation; this takes '
              'a minute or more', file=sys.stderr, flush=True)


_told: list[bool] = []


@contextmanager
def _keeping() -> Iterator[bool]:
    """Have machine code kept in this package's own folder; whether there is one.

    Numba tells by a function's own file whether its machine code is still good. Ours call each
    other across files, so the folder's name stands for all of them.
    """
    before, folder = numba.config.CACHE_DIR, machine_code_folder(
        numba.config.CACHE_DIR, '-checked' if numba.config.BOUNDSCHECK else '')
    numba.config.CACHE_DIR = str(folder or '')
    try:
        yield folder is not None
    finally:
        numba.config.CACHE_DIR = before

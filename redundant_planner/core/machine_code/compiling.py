"""How functions are compiled by given means, and their machine code kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import itertools
from pathlib import Path
from typing import Any, cast, TypeVar

import numba
from numba import types

from redundant_planner.core.machine_code.argument_types import argument_types, LOCAL
from redundant_planner.core.machine_code.crossing import (
    borrowing,
    crossings,
    handing_over,
    taking_parts,
)
from redundant_planner.core.machine_code.means import Means
from redundant_planner.core.machine_code.progress import Announcer, Listener
from redundant_planner.core.machine_code_cache import machine_code_folder, seal

_Function = TypeVar('_Function', bound=Callable[..., object])

# Told of each function that is ready, and whether it had to be compiled.
listeners: list[Listener] = []


def compile_called(function: _Function, means: Means) -> _Function:
    """Compile a function that Python and compiled functions call."""
    return _compile(borrowing(function, means.ownership), argument_types(function), means)


def compile_inlined(function: _Function, means: Means) -> _Function:
    """Compile a function that only compiled functions call."""
    return _compile(function, argument_types(function), means, inlined=True)


def compile_entry(function: _Function, means: Means) -> _Function:
    """Compile a function that only Python calls."""
    arguments = crossings(function)
    kinds = itertools.chain(*(argument.kinds for argument in arguments))
    inner = _compile(
        taking_parts(function, arguments, means.ownership), tuple(kinds), means)
    return cast(_Function, handing_over(function, arguments, inner))


def _compile(
    function: _Function, arguments: tuple[types.Type, ...], means: Means, *,
    inlined: bool = False,
) -> _Function:
    options = means.inlined if inlined else means.called
    with _keeping(means) as kept, means.naming(function):
        dispatcher: Any = numba.njit(
            arguments, cache=kept, error_model='numpy', **options)(function)
    if not inlined and LOCAL not in function.__qualname__:
        means.share(dispatcher)
    stats = getattr(dispatcher, 'stats', None)
    missed = stats is None or bool(stats.cache_misses)
    if missed and kept and stats is not None:
        seal(Path(stats.cache_path), f'.{function.__qualname__}-')
    if not listeners:
        listeners.append(Announcer())
    for listener in listeners:
        listener(f'{function.__module__}.{function.__qualname__}', compiled=missed)
    return cast(_Function, dispatcher)


@contextmanager
def _keeping(means: Means) -> Iterator[bool]:
    """Have machine code kept in this package's own folder; whether there is one.

    Numba tells by a function's own file whether its machine code is still good. Ours call each
    other across files, so the folder's name stands for all of them. It also stands for what
    Numba does not ask: by which means they were compiled, and whether with bounds checks.
    """
    config = numba.config
    if not (hasattr(config, 'CACHE_DIR') and hasattr(config, 'BOUNDSCHECK')):
        yield False
        return
    before, checks = config.CACHE_DIR, '-checked' if config.BOUNDSCHECK else ''
    folder = machine_code_folder(before, means.folder + checks)
    config.CACHE_DIR = str(folder or '')
    try:
        yield folder is not None
    finally:
        config.CACHE_DIR = before

"""What functions are compiled with: Numba's insides, or what Numba promises."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, NamedTuple

from numba import types


class Means(NamedTuple):
    """What functions are compiled with.

    Attributes:
        folder: how the name of their folder ends.
        called: options of a function that is called.
        inlined: options of a kernel.
        ownership: the functions `borrowed`, `owned` and `borrowed_part`, by name.
        naming: a context to compile a function in.
        share: what happens to it then, if others call it.
    """

    folder: str
    called: dict[str, bool]
    inlined: dict[str, bool]
    ownership: dict[str, Any]
    naming: Callable[[Callable[..., object]], AbstractContextManager[None]]
    share: Callable[[Any], None]


def entrywise(change: Callable[[Any], Any], value: types.Type) -> Any:
    """Return a function that changes the entries of a tuple, and returns all else as it is."""
    if not isinstance(value, types.BaseTuple) or not _holds_arrays(value):
        return lambda value: value
    named = isinstance(value, types.BaseNamedTuple)
    entries = ''.join(f'change(value[{i}]), ' for i in range(len(value)))
    scope: dict[str, Any] = {'change': change, 'made': value.instance_class if named else None}
    exec(f'def changed(value): return {"made" if named else ""}({entries})', scope)
    return scope['changed']


def _holds_arrays(value: types.BaseTuple) -> bool:
    return any(isinstance(entry, types.Array) or (
        isinstance(entry, types.BaseTuple) and _holds_arrays(entry)) for entry in value)

"""All that this package uses of Numba's insides, in one place: they change without notice.

`trial` tries it once in each process; `plain_numba` does without.

Borrowed arrays: machine code borrows them from whoever calls it, and counts no references to them.
Numba counts references to every array, and a NamedTuple of ten that is handed on counts ten. In
a tick that took longer than its arithmetic. Arguments need no counting: whoever called holds them
until the call returns. Only what is returned must not be borrowed.

Names: each function's machine code bears the same one in all processes, so that compiled functions
call each other by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import itertools
from typing import Any, TypeVar
import zlib

from numba import types
from numba.core import cgutils
from numba.core.bytecode import FunctionIdentity
from numba.extending import intrinsic, overload
from numba.np.arrayobj import populate_array

from redundant_planner.core.machine_code.argument_types import LOCAL
from redundant_planner.core.machine_code.means import entrywise, Means

_Value = TypeVar('_Value')


def borrowed(value: _Value) -> _Value:
    """Return an argument with all arrays in it borrowed."""
    return value


def owned(value: _Value) -> _Value:
    """Return what may be returned: borrowed arrays as copies, all else as it is."""
    return value


@intrinsic  # type: ignore[untyped-decorator]
def _without_owner(_typing: object, array: types.Array) -> Any:
    def lent(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        found = context.make_array(signature.return_type)(context, builder, value=arguments[0])
        found.meminfo = cgutils.get_null_value(found.meminfo.type)
        found.parent = cgutils.get_null_value(found.parent.type)
        return found._getvalue()

    return array(array), lent


@intrinsic  # type: ignore[untyped-decorator]
def _has_owner(_typing: object, array: types.Array) -> Any:
    def asked(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        found = context.make_array(signature.args[0])(context, builder, value=arguments[0])
        return cgutils.is_not_null(builder, found.meminfo)

    return types.boolean(array), asked


@intrinsic  # type: ignore[untyped-decorator]
def borrowed_part(
    _typing: object, array: types.Array, start: types.Type, shape: types.BaseTuple,
) -> Any:
    """Return a part of an array (k,), from an entry on, as a borrowed array of another shape.

    Slicing and `reshape` take ten times as long.
    """
    part = types.Array(array.dtype, len(shape), 'C')

    def taken(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        whole = context.make_array(array)(context, builder, value=arguments[0])
        made = context.make_array(part)(context, builder)
        lengths = cgutils.unpack_tuple(builder, arguments[2])
        strides = [whole.itemsize]
        for length in lengths[:0:-1]:
            strides.insert(0, builder.mul(strides[0], length))
        populate_array(
            made, builder.gep(whole.data, [arguments[1]]), lengths, strides, whole.itemsize, None)
        return made._getvalue()

    return part(array, start, shape), taken


@overload(borrowed, strict=False)  # type: ignore[untyped-decorator]
def _borrowed(value: types.Type) -> Any:
    if isinstance(value, types.Array):
        return lambda value: _without_owner(value)
    return entrywise(borrowed, value)


@overload(owned, strict=False)  # type: ignore[untyped-decorator]
def _owned(value: types.Type) -> Any:
    if isinstance(value, types.Array):
        return lambda value: value if _has_owner(value) else value.copy()
    return entrywise(owned, value)


@contextmanager
def named_alike_everywhere(function: Callable[..., object]) -> Iterator[None]:
    """Have a function's machine code bear the same name in all processes that compile it.

    Numba's names end in a number that counts up: what is compiled here would not find what
    another process compiled and kept. Functions within functions keep such numbers: those of one
    name need not be the same.
    """
    if LOCAL in function.__qualname__:
        yield
        return
    before = FunctionIdentity._unique_ids
    FunctionIdentity._unique_ids = itertools.count(_first_number(function))
    try:
        yield
    finally:
        FunctionIdentity._unique_ids = before


def named_alike(dispatcher: Any) -> bool:
    """Return whether what was compiled bears the name that `named_alike_everywhere` wants."""
    (version,) = dispatcher.overloads.values()
    return version.fndesc.uid == _first_number(dispatcher.py_func)


def _first_number(function: Callable[..., object]) -> int:
    return zlib.crc32(f'{function.__module__}.{function.__qualname__}'.encode()) << 16


def share(dispatcher: Any) -> None:
    """Have compiled functions call this one by its name.

    Numba would compile it again into each of them, and with it all that it calls: a quarter more
    work, for ticks that are no faster.
    """
    for version in dispatcher.overloads.values():
        context, function = version.target_context, version.entry_point
        context.remove_user_function(function)
        context.insert_user_function(function, version.fndesc)


_NO_CFUNC = {'no_cfunc_wrapper': True}
INTERNALS = Means(
    folder='', called=_NO_CFUNC,
    inlined={**_NO_CFUNC, 'no_cpython_wrapper': True, 'forceinline': True},
    ownership={'borrowed': borrowed, 'borrowed_part': borrowed_part, 'owned': owned},
    naming=named_alike_everywhere, share=share)

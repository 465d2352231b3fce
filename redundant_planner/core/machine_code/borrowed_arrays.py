"""Arrays that machine code borrows from whoever calls it: no references to them are counted.

Numba counts references to every array, and a NamedTuple of ten that is handed on counts ten. In
a tick that took longer than its arithmetic. Arguments need no counting: whoever called holds them
until the call returns. Only what is returned must not be borrowed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload
from numba.np.arrayobj import populate_array

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
    return _each(borrowed, value)


@overload(owned, strict=False)  # type: ignore[untyped-decorator]
def _owned(value: types.Type) -> Any:
    if isinstance(value, types.Array):
        return lambda value: value if _has_owner(value) else value.copy()
    return _each(owned, value)


def _each(change: Callable[[Any], Any], value: types.Type) -> Any:
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

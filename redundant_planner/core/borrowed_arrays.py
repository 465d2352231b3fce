"""Arrays that machine code borrows from Python: no references to them are counted.

Numba counts references to every array, and a NamedTuple of ten that is handed on counts ten. In
a tick that took longer than its arithmetic. Arguments need no counting: whoever called holds them
until the call returns. Only what is returned must not be borrowed.
"""

from __future__ import annotations

from typing import Any, TYPE_CHECKING, TypeVar

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

if TYPE_CHECKING:
    from numba.core.base import BaseContext

_Kept = TypeVar('_Kept')


@intrinsic  # type: ignore[untyped-decorator]
def borrowed(_typing: object, array: types.Array) -> Any:
    """Return an argument's array without its owner; only machine code can call this."""
    def lent(context: BaseContext, builder: Any, signature: Any, arguments: Any) -> Any:
        found = context.make_array(signature.return_type)(context, builder, value=arguments[0])
        found.meminfo = cgutils.get_null_value(found.meminfo.type)
        found.parent = cgutils.get_null_value(found.parent.type)
        return found._getvalue()

    return array(array), lent


@intrinsic  # type: ignore[untyped-decorator]
def _has_owner(_typing: object, array: types.Array) -> Any:
    def asked(context: BaseContext, builder: Any, signature: Any, arguments: Any) -> Any:
        found = context.make_array(signature.args[0])(context, builder, value=arguments[0])
        return cgutils.is_not_null(builder, found.meminfo)

    return types.boolean(array), asked


def owned(value: _Kept) -> _Kept:
    """Return what Python may keep: a copy of a borrowed array, anything else as it is."""
    return value


@overload(owned, strict=False)  # type: ignore[untyped-decorator]
def _owned(value: types.Type) -> Any:
    if isinstance(value, types.Array):
        return lambda value: value if _has_owner(value) else value.copy()
    return lambda value: value

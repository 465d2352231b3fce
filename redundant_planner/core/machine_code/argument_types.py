"""The types of Numba that annotations name."""

from __future__ import annotations

from collections.abc import Callable
import itertools
import sys
from typing import Any

from numba import types

_ARRAYS = {
    'Vector': (types.float64, 1), 'Matrix': (types.float64, 2), 'Stack': (types.float64, 3),
    'Stacks': (types.float64, 4), 'Indices': (types.intp, 1), 'IndexPairs': (types.intp, 2),
    'Flags': (types.boolean, 1), 'FlagMatrix': (types.boolean, 2),
    'OutVector': (types.float64, 1), 'OutMatrix': (types.float64, 2),
    'OutStack': (types.float64, 3)}
SCALARS = {'float': types.float64, 'int': types.intp, 'bool': types.boolean}
LOCAL = '<locals>'  # in the qualified names of functions within functions


def argument_types(function: Callable[..., object]) -> tuple[types.Type, ...]:
    """Return the types of a function's arguments."""
    return tuple(
        argument_type(str(annotation), function.__globals__)
        for name, annotation in function.__annotations__.items() if name != 'return')


def argument_type(name: str, scope: dict[str, object]) -> types.Type:
    """Return the type that an annotation names, of an argument."""
    if name in SCALARS:
        return SCALARS[name]
    if name in _ARRAYS:
        dtype, dimensions = _ARRAYS[name]
        return types.Array(dtype, dimensions, 'A', readonly=not name.startswith('Out'))
    return tuple_type(scope[name])


def tuple_type(cls: Any) -> types.Type:
    """Return the type of a NamedTuple."""
    fields = []
    for annotation in cls.__annotations__.values():
        name = getattr(annotation, '__forward_arg__', str(annotation))
        scope = vars(sys.modules[cls.__module__])
        if name in _ARRAYS:
            fields.append(types.Array(*_ARRAYS[name], 'C'))
        else:
            fields.append(argument_type(name, scope))
    if len(set(fields)) == 1:
        return types.NamedUniTuple(fields[0], len(fields), cls)
    return types.NamedTuple(fields, cls)


def field_types(kind: types.Type) -> list[types.Type]:
    """Return the types of a NamedTuple's fields, those of NamedTuples within it among them."""
    if not isinstance(kind, types.BaseNamedTuple):
        return [kind]
    return list(itertools.chain(*map(field_types, kind.types)))


def record_of(annotation: str, scope: dict[str, Any]) -> Any:
    """Return the NamedTuple that an annotation names; None if it names something else."""
    named = scope.get(annotation)
    return named if hasattr(named, '_fields') else None


def fields_of(record: Any) -> dict[str, Any]:
    """Return the fields of a NamedTuple, each with the NamedTuple that it holds or None."""
    scope = vars(sys.modules[record.__module__])
    return {name: record_of(getattr(annotation, '__forward_arg__', str(annotation)), scope)
            for name, annotation in record.__annotations__.items()}

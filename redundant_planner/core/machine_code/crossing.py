"""How arguments and results cross over between Python and machine code.

A function's source gets lines that take its arguments over, and other answers. Of the `entry`

    def wish(start: Start, setup: Packed[Setup]) -> Wish:
        return Wish(...)

this is compiled,

    def wish(start_arm, start_dt, setup_numbers, setup_integers):
        start = borrowed(Start(start_arm, start_dt))
        setup = _Unpacked(Setup(borrowed_part(setup_numbers, ...), ...))
        returned = owned(Wish(...))
        return (returned.motions, returned.factor)

and this is what Python calls:

    def call(start, setup):
        (found_motions, found_factor) = inner(*start, setup.numbers, setup.integers)
        return new(Wish, (found_motions, found_factor,))

`numba_internals` says what borrowed and owned arrays are.
"""

from __future__ import annotations
import __future__

import ast
import copy
import functools
import inspect
import itertools
import textwrap
from typing import Any, NamedTuple

from numba import types

from redundant_planner.core.machine_code.argument_types import (
    argument_type,
    field_types,
    fields_of,
    LOCAL,
    record_of,
    SCALARS,
    tuple_type,
)
from redundant_planner.core.machine_code.packed import layout_of

_PACKED = 'Packed['


class _Unpacked(NamedTuple):
    """What a `Packed` argument is in machine code."""

    value: Any


class Crossing(NamedTuple):
    """How an argument of an `entry` crosses over.

    Attributes:
        name: of the argument.
        handed: what Python hands over: expressions.
        parts: the names of these in machine code.
        kinds: their types.
        lines: that make the argument of them.
        classes: that these use, by name.
    """

    name: str
    handed: str
    parts: list[str]
    kinds: list[types.Type]
    lines: list[str]
    classes: dict[str, Any]


def crossings(function: Any) -> list[Crossing]:
    """Return how the arguments of an `entry` cross over."""
    scope = function.__globals__
    return [_packed(name, scope[str(annotation)[len(_PACKED):-1]])
            if str(annotation).startswith(_PACKED) else _taken_apart(name, str(annotation), scope)
            for name, annotation in function.__annotations__.items() if name != 'return']


def _packed(name: str, record: Any) -> Crossing:
    kind = tuple_type(record)
    made, _ = _unpacked(name, kind, 1)
    layout = layout_of(
        (_is_float(entry), getattr(entry, 'ndim', 0)) for entry in field_types(kind))
    return Crossing(
        name, f'{name}.numbers, {name}.integers', [f'{name}_numbers', f'{name}_integers'],
        [types.Array(types.float64, 1, 'C'), types.Array(types.intp, 1, 'C')],
        [f'if {name}_integers[0] != {layout}:',
         f'    raise TypeError("argument {name} must be a packed {record.__name__}")',
         f'{name} = _Unpacked({made})'], {**_classes(record), '_Unpacked': _Unpacked})


def _taken_apart(name: str, annotation: str, scope: dict[str, Any]) -> Crossing:
    record = record_of(annotation, scope)
    made = _made(name, record, '{name}({fields})')
    return Crossing(
        name, _handed(name, record), [leaf for leaf, _ in _leaves(name, record)],
        field_types(argument_type(annotation, scope)),
        [] if annotation in SCALARS else [f'{name} = borrowed({made})'], _classes(record))


def _is_float(kind: types.Type) -> bool:
    return getattr(kind, 'dtype', kind) == types.float64


def _unpacked(name: str, kind: types.Type, at: int) -> tuple[str, int]:
    """Return the expression that makes a value of a `Packed` argument again.

    Args:
        name: of the argument.
        kind: of the value.
        at: where the header tells of it.

    Returns:
        It, and where the header goes on.
    """
    if isinstance(kind, types.BaseNamedTuple):
        entries = []
        for inner in kind.types:
            entry, at = _unpacked(name, inner, at)
            entries.append(entry)
        return f'{kind.instance_class.__name__}({", ".join(entries)})', at
    dimensions = kind.ndim if isinstance(kind, types.Array) else 0
    source = f'{name}_numbers' if _is_float(kind) else f'{name}_integers'
    first = f'{name}_integers[{at}]'
    after = at + 1 + dimensions
    if dimensions:
        shape = ''.join(f'{name}_integers[{i}], ' for i in range(at + 1, after))
        return f'borrowed_part({source}, {first}, ({shape}))', after
    return f'{source}[{first}]' + (' != 0' if kind == types.boolean else ''), after


def _classes(record: Any) -> dict[str, Any]:
    """Return a NamedTuple and all within it by name; none for None."""
    if record is None:
        return {}
    return functools.reduce(
        lambda found, inner: found | _classes(inner), fields_of(record).values(),
        {record.__name__: record})


def _leaves(name: str, record: Any) -> list[tuple[str, str]]:
    """Return a variable's name, and an expression, for every array and number in a NamedTuple."""
    if record is None:
        return [(name.replace('.', '_'), name)]
    return list(itertools.chain(*(
        _leaves(f'{name}.{field}', inner) for field, inner in fields_of(record).items())))


def _handed(value: str, record: Any) -> str:
    """Return the arguments that a NamedTuple is taken apart to."""
    if record is None:
        return value
    fields = fields_of(record)
    if not any(fields.values()):
        return f'*{value}'
    return ', '.join(_handed(f'{value}.{name}', inner) for name, inner in fields.items())


def _made(name: str, record: Any, pattern: str) -> str:
    """Return the expression that makes a NamedTuple of the variables of `_leaves`."""
    if record is None:
        return name
    fields = ', '.join(
        _made(f'{name}_{field}', inner, pattern) for field, inner in fields_of(record).items())
    return pattern.format(name=record.__name__, fields=fields)


def taking_parts(function: Any, arguments: list[Crossing], ownership: dict[str, Any]) -> Any:
    """Return a function that takes its arguments, and returns a NamedTuple's fields, one by one.

    Its source gets the lines `arm = borrowed(Kinematics(arm_q, ...))` that would otherwise stand
    in every such function.

    Args:
        function: an `entry`.
        arguments: how they cross over.
        ownership: of `Means`.
    """
    result = _result(function)
    leaves = ''.join(f'{value}, ' for _, value in _leaves('returned', result))
    returned = 'returned' if result is None else f'({leaves})'
    return _rewritten(
        function, list(itertools.chain(*(argument.parts for argument in arguments))),
        list(itertools.chain(*(argument.lines for argument in arguments))), f'return {returned}',
        functools.reduce(lambda found, argument: found | argument.classes, arguments, {}),
        ownership)


def handing_over(function: Any, arguments: list[Crossing], inner: Any) -> Any:
    """Return a function that calls what was compiled of `taking_parts` with its own arguments."""
    result = _result(function)
    returned, made = 'found', 'found'
    if result is not None:
        returned = '(' + ''.join(f'{name}, ' for name, _ in _leaves('found', result)) + ')'
        made = _made('found', result, 'new({name}, ({fields},))')
    scope: dict[str, Any] = {'inner': inner, 'new': tuple.__new__, **_classes(result)}
    exec(f'def call({", ".join(argument.name for argument in arguments)}):\n'
         f'    {returned} = inner({", ".join(argument.handed for argument in arguments)})\n'
         f'    return {made}', scope)
    return functools.wraps(function)(scope['call'])


def _result(function: Any) -> Any:
    """Return the NamedTuple that a function returns; None if it returns something else."""
    return record_of(str(function.__annotations__.get('return')), function.__globals__)


def borrowing(function: Any, ownership: dict[str, Any]) -> Any:
    """Return a function that borrows its arguments, see `numba_internals`.

    One within another function is left as it is: made anew, it would lose what it closes over.

    Args:
        function: a `compiled` one.
        ownership: of `Means`.
    """
    if LOCAL in function.__qualname__:
        return function
    names = [name for name in function.__annotations__ if name != 'return']
    return _rewritten(
        function, names, [f'{name} = borrowed({name})' for name in names
                          if function.__annotations__[name] not in SCALARS],
        'return returned', {}, ownership)


def _rewritten(
    function: Any, arguments: list[str], lines: list[str], answer: str, names: dict[str, Any],
    ownership: dict[str, Any],
) -> Any:
    """Return a function with other arguments, more lines at its beginning, and another answer.

    It keeps its file and its line numbers: debuggers and Numba's cache go by them.

    Args:
        function: from a file.
        arguments: their names.
        lines: what it is to do first.
        answer: a return statement, of what is in `returned`.
        names: that the lines use.
        ownership: of `Means`: that the lines and the answer use.
    """
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    definition = tree.body[0]
    assert isinstance(definition, ast.FunctionDef)
    definition.decorator_list = []
    if function.__annotations__.get('return') not in SCALARS:
        definition = _Answers(answer).visit(definition)
    definition.args.args = [ast.arg(name) for name in arguments]
    first = 0 if ast.get_docstring(definition) is None else 1
    definition.body[first:first] = ast.parse('\n'.join(lines)).body
    ast.fix_missing_locations(tree)
    ast.increment_lineno(tree, function.__code__.co_firstlineno - 1)
    scope: dict[str, Any] = {}
    code = compile(tree, function.__code__.co_filename, 'exec', dont_inherit=True,
                   flags=__future__.annotations.compiler_flag)
    exec(code, {**names, **function.__globals__, **ownership}, scope)
    return scope[function.__name__]


class _Answers(ast.NodeTransformer):
    """Makes `return x` another answer of which nothing is borrowed."""

    def __init__(self, answer: str) -> None:
        self._plain = ast.parse(f'returned = owned(0)\n{answer}').body

    def visit_Return(self, node: ast.Return) -> list[ast.stmt]:
        if node.value is None:
            return [node]
        assignment, answer = copy.deepcopy(self._plain)
        assert isinstance(assignment, ast.Assign) and isinstance(assignment.value, ast.Call)
        assignment.value.args = [node.value]
        return [ast.copy_location(assignment, node), ast.copy_location(answer, node)]

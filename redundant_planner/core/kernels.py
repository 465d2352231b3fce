"""Machine code for what runs in every tick (Numba).

A tick is some thousand additions and multiplications on arrays of a few numbers. NumPy takes a
microsecond for each call on them; compiled, all of them together take little more. The functions
that are marked here are plain Python, compiled when their module is first imported. The machine
code is kept, so later starts only load it. `NUMBA_DISABLE_JIT=1` runs the same code as Python,
for a debugger.

Argument types come from the annotations, once: a type that only turned up later would stop the
control loop while it is being compiled. A wrong one is a TypeError instead.
"""

from __future__ import annotations
import __future__

import ast
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import copy
import functools
import inspect
import itertools
from pathlib import Path
import sys
import textwrap
from typing import Any, cast, TypeVar
import zlib

import numba
from numba import types
from numba.core.bytecode import FunctionIdentity
import numpy as np
import numpy.typing as npt

from redundant_planner.core.borrowed_arrays import borrowed, owned
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

_ARRAYS = {
    'Vector': (types.float64, 1), 'Matrix': (types.float64, 2), 'Stack': (types.float64, 3),
    'Stacks': (types.float64, 4), 'Indices': (types.intp, 1), 'IndexPairs': (types.intp, 2),
    'Flags': (types.boolean, 2), 'OutVector': (types.float64, 1),
    'OutMatrix': (types.float64, 2), 'OutStack': (types.float64, 3)}
_SCALARS = {'float': types.float64, 'int': types.intp, 'bool': types.boolean}

_LOCAL = '<locals>'
_Function = TypeVar('_Function', bound=Callable[..., object])


def compiled(function: _Function) -> _Function:
    """Compile a function for the argument types that its annotations name.

    They are the names above, float, int, bool, and NamedTuples of these. It borrows its arguments
    (`borrowed_arrays`): those that it returns are copies. Division by zero gives infinity or NaN,
    as in NumPy.
    """
    if numba.config.DISABLE_JIT:
        return function
    return _compile(_borrowing(function), _argument_types(function), {})


def kernel(function: _Function) -> _Function:
    """Compile a function, as `compiled`, into those that call it: only compiled functions can.

    A call of its own would copy the descriptions of all arrays in its arguments and count
    references to them. With the records of a scene that takes 150 ns, more than most functions
    here compute for.
    """
    return _compile(
        function, _argument_types(function), {'no_cpython_wrapper': True, 'forceinline': True})


def entry(function: _Function) -> _Function:
    """Compile a function, as `compiled`, that only Python calls, in every tick.

    Numba takes arrays and numbers over from Python in half the time that NamedTuples of them
    need. All NamedTuples are therefore taken apart on the one side and put together on the
    other. They may be arguments, the result, and fields of either.
    """
    if numba.config.DISABLE_JIT:
        return function
    records = {name: _record(str(annotation), function.__globals__)
               for name, annotation in function.__annotations__.items()}
    result = records.pop('return', None)
    inner = _compile(
        _taking_fields(function, records, result),
        tuple(itertools.chain(*map(_field_types, _argument_types(function)))), {})
    handed = ', '.join(_handed(name, record) for name, record in records.items())
    returned, made = 'found', 'found'
    if result is not None:
        returned = '(' + ''.join(f'{name}, ' for name, _ in _leaves('found', result)) + ')'
        made = _made('found', result, 'new({name}, ({fields},))')
    scope: dict[str, Any] = {'inner': inner, 'new': tuple.__new__, **_classes(result)}
    exec(f'def call({", ".join(records)}):\n    {returned} = inner({handed})\n    return {made}',
         scope)
    return cast(_Function, functools.wraps(function)(scope['call']))


def _field_types(kind: types.Type) -> list[types.Type]:
    """Return the types of a NamedTuple's fields, those of NamedTuples within it among them."""
    if not isinstance(kind, types.BaseNamedTuple):
        return [kind]
    return list(itertools.chain(*map(_field_types, kind.types)))


def _record(annotation: str, scope: dict[str, Any]) -> Any:
    """Return the NamedTuple that an annotation names; None if it names something else."""
    named = scope.get(annotation)
    return named if hasattr(named, '_fields') else None


def _fields_of(record: Any) -> dict[str, Any]:
    """Return the fields of a NamedTuple, each with the NamedTuple that it holds or None."""
    scope = vars(sys.modules[record.__module__])
    return {name: _record(getattr(annotation, '__forward_arg__', str(annotation)), scope)
            for name, annotation in record.__annotations__.items()}


def _classes(record: Any) -> dict[str, Any]:
    """Return a NamedTuple and all within it by name; none for None."""
    if record is None:
        return {}
    return functools.reduce(
        lambda found, inner: found | _classes(inner), _fields_of(record).values(),
        {record.__name__: record})


def _leaves(name: str, record: Any) -> list[tuple[str, str]]:
    """Return a variable's name, and an expression, for every array and number in a NamedTuple."""
    if record is None:
        return [(name.replace('.', '_'), name)]
    return list(itertools.chain(*(
        _leaves(f'{name}.{field}', inner) for field, inner in _fields_of(record).items())))


def _handed(value: str, record: Any) -> str:
    """Return the arguments that a NamedTuple is taken apart to."""
    if record is None:
        return value
    fields = _fields_of(record)
    if not any(fields.values()):
        return f'*{value}'
    return ', '.join(_handed(f'{value}.{name}', inner) for name, inner in fields.items())


def _made(name: str, record: Any, pattern: str) -> str:
    """Return the expression that makes a NamedTuple of the variables of `_leaves`."""
    if record is None:
        return name
    fields = ', '.join(
        _made(f'{name}_{field}', inner, pattern) for field, inner in _fields_of(record).items())
    return pattern.format(name=record.__name__, fields=fields)


def _taking_fields(function: Any, records: dict[str, Any], result: Any) -> Any:
    """Return a function that takes and returns the fields of NamedTuples one by one.

    Its source gets the lines `arm = borrowed(Kinematics(arm_q, ...))` that would otherwise stand
    in every such function.
    """
    arguments = [leaf for name, record in records.items() for leaf, _ in _leaves(name, record)]
    lines = [f'{name} = borrowed({_made(name, record, "{name}({fields})")})'
             for name, record in records.items() if function.__annotations__[name] not in _SCALARS]
    leaves = ''.join(f'{value}, ' for _, value in _leaves('returned', result))
    returned = 'returned' if result is None else f'({leaves})'
    names = {cls.__name__: cls for record in records.values() for cls in _classes(record).values()}
    return _rewritten(function, arguments, lines, f'return {returned}', names)


def _borrowing(function: Any) -> Any:
    """Return a function that borrows its arguments, see `borrowed_arrays`.

    One within another function is left as it is: made anew, it would lose what it closes over.
    """
    if _LOCAL in function.__qualname__:
        return function
    names = [name for name in function.__annotations__ if name != 'return']
    return _rewritten(
        function, names, [f'{name} = borrowed({name})' for name in names
                          if function.__annotations__[name] not in _SCALARS],
        'return returned', {})


def _rewritten(
    function: Any, arguments: list[str], lines: list[str], answer: str, names: dict[str, Any],
) -> Any:
    """Return a function with other arguments, more lines at its beginning, and another answer.

    It keeps its file and its line numbers: debuggers and Numba's cache go by them.

    Args:
        function: from a file.
        arguments: their names.
        lines: what it is to do first.
        answer: a return statement, of what is in `returned`.
        names: that the lines use.
    """
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    definition = tree.body[0]
    assert isinstance(definition, ast.FunctionDef)
    definition.decorator_list = []
    if function.__annotations__.get('return') not in _SCALARS:
        definition = _Answers(answer).visit(definition)
    definition.args.args = [ast.arg(name) for name in arguments]
    first = 0 if ast.get_docstring(definition) is None else 1
    definition.body[first:first] = ast.parse('\n'.join(lines)).body
    ast.fix_missing_locations(tree)
    ast.increment_lineno(tree, function.__code__.co_firstlineno - 1)
    scope: dict[str, Any] = {}
    code = compile(tree, function.__code__.co_filename, 'exec', dont_inherit=True,
                   flags=__future__.annotations.compiler_flag)
    exec(code, {**names, **function.__globals__, 'borrowed': borrowed, 'owned': owned}, scope)
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


def _argument_types(function: Callable[..., object]) -> tuple[types.Type, ...]:
    return tuple(
        _argument_type(str(annotation), function.__globals__)
        for name, annotation in function.__annotations__.items() if name != 'return')


def _compile(
    function: _Function, arguments: tuple[types.Type, ...], options: dict[str, bool],
) -> _Function:
    if numba.config.DISABLE_JIT:
        return function
    with _keeping() as kept, _named_alike_everywhere(function):
        dispatcher = numba.njit(
            arguments, cache=kept, error_model='numpy', no_cfunc_wrapper=True, **options,
        )(function)
    if 'forceinline' not in options and _LOCAL not in function.__qualname__:
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
    if _LOCAL in function.__qualname__:
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


def _argument_type(name: str, scope: dict[str, object]) -> types.Type:
    if name in _SCALARS:
        return _SCALARS[name]
    if name in _ARRAYS:
        dtype, dimensions = _ARRAYS[name]
        return types.Array(dtype, dimensions, 'A', readonly=not name.startswith('Out'))
    return _tuple_type(scope[name])


def _tuple_type(cls: Any) -> types.Type:
    fields = []
    for annotation in cls.__annotations__.values():
        name = getattr(annotation, '__forward_arg__', str(annotation))
        scope = vars(sys.modules[cls.__module__])
        if name in _ARRAYS:
            fields.append(types.Array(*_ARRAYS[name], 'C'))
        else:
            fields.append(_argument_type(name, scope))
    if len(set(fields)) == 1:
        return types.NamedUniTuple(fields[0], len(fields), cls)
    return types.NamedTuple(fields, cls)


@contextmanager
def _keeping() -> Iterator[bool]:
    """Have machine code kept in this package's own folder; whether there is one.

    Numba tells by a function's own file whether its machine code is still good. Ours call each
    other across files, so the folder's name stands for all of them.
    """
    before, folder = numba.config.CACHE_DIR, machine_code_folder(numba.config.CACHE_DIR)
    numba.config.CACHE_DIR = str(folder or '')
    try:
        yield folder is not None
    finally:
        numba.config.CACHE_DIR = before

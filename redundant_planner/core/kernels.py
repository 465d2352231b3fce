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
import contextlib
from contextlib import contextmanager
import copy
import functools
import hashlib
import inspect
import os
from pathlib import Path
import shutil
import stat
import sys
import textwrap
from typing import Any, cast, TypeVar, Union
import zlib

import numba
from numba import types
import numpy as np
import numpy.typing as npt

from redundant_planner.core.cache_folder import cache_folder

# Arrays of 1, 2, 3 and 4 dimensions. As arguments in any order and read-only or not; as fields
# of a NamedTuple C-ordered and writeable.
Vector = npt.NDArray[np.float64]
Matrix = npt.NDArray[np.float64]
Stack = npt.NDArray[np.float64]
Stacks = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
IndexPairs = npt.NDArray[np.intp]
# Arguments that the function fills.
OutVector = npt.NDArray[np.float64]
OutMatrix = npt.NDArray[np.float64]
OutStack = npt.NDArray[np.float64]

_ARRAYS = {
    'Vector': (types.float64, 1), 'Matrix': (types.float64, 2), 'Stack': (types.float64, 3),
    'Stacks': (types.float64, 4), 'Indices': (types.intp, 1), 'IndexPairs': (types.intp, 2),
    'OutVector': (types.float64, 1), 'OutMatrix': (types.float64, 2),
    'OutStack': (types.float64, 3)}
_SCALARS = {'float': types.float64, 'int': types.intp, 'bool': types.boolean}

_Tuple = TypeVar('_Tuple')
# A NamedTuple, handed over as the plain tuple of its fields: Numba takes those in half the time.
Fields = Union[_Tuple, tuple[Any, ...]]  # noqa: UP007

_Function = TypeVar('_Function', bound=Callable[..., object])


def compiled(function: _Function) -> _Function:
    """Compile a function for the argument types that its annotations name.

    They are the names above, float, int, bool, NamedTuples of these, and `Fields` of such.
    Division by zero gives infinity or NaN, as in NumPy.
    """
    return _compile(function, _argument_types(function), {})


def kernel(function: _Function) -> _Function:
    """Compile a function, as `compiled`, that only compiled functions call.

    It gets no code that takes arguments over from Python, which saves a good part of the work.
    """
    return _compile(function, _argument_types(function), {'no_cpython_wrapper': True})


def entry(function: _Function) -> _Function:
    """Compile a function, as `compiled`, that only Python calls, in every tick.

    Numba takes a plain tuple over from Python in half the time that a NamedTuple needs. All
    NamedTuples therefore cross over as plain tuples; both sides only see NamedTuples. These may
    be arguments, the result, and fields of either.
    """
    if numba.config.DISABLE_JIT:
        return function
    records = {name: _record(str(annotation), function.__globals__)
               for name, annotation in function.__annotations__.items()}
    result = records.pop('return', None)
    inner = _compile(_unpacking(function, records, result),
                     tuple(map(_plain_type, _argument_types(function))), {})
    handed = ', '.join(_packed(name, record) for name, record in records.items())
    returned = 'found' if result is None else _unpacked('found', result)
    scope: dict[str, Any] = {'inner': inner, **_classes(result)}
    exec(f'def call({", ".join(records)}):\n    found = inner({handed})\n    return {returned}',
         scope)
    return cast(_Function, functools.wraps(function)(scope['call']))


def _plain_type(kind: types.Type) -> types.Type:
    """Return the type of a plain tuple for that of a NamedTuple."""
    if not isinstance(kind, types.BaseNamedTuple):
        return kind
    return types.Tuple(tuple(map(_plain_type, kind.types)))


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


def _packed(value: str, record: Any) -> str:
    """Return the expression that makes plain tuples of a NamedTuple and of those within it."""
    if record is None:
        return value
    fields = _fields_of(record)
    if not any(fields.values()):
        return f'{value}[:]'
    return '(' + ''.join(
        f'{_packed(f"{value}.{name}", inner)}, ' for name, inner in fields.items()) + ')'


def _unpacked(value: str, record: Any) -> str:
    """Return the expression that makes a NamedTuple of the tuples that `_packed` made."""
    fields = _fields_of(record)
    if not any(fields.values()):
        return f'{record.__name__}(*{value})'
    parts = ', '.join(
        _unpacked(f'{value}[{i}]', inner) if inner else f'{value}[{i}]'
        for i, inner in enumerate(fields.values()))
    return f'{record.__name__}({parts})'


def _unpacking(function: Any, records: dict[str, Any], result: Any) -> Any:
    """Return a function that takes plain tuples for its records, and returns plain tuples.

    Its source gets the lines `arm = Kinematics(*arm)` that would otherwise stand in every such
    function. It keeps its file and its line numbers: debuggers and Numba's cache go by them.
    """
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    definition = tree.body[0]
    assert isinstance(definition, ast.FunctionDef)
    definition.decorator_list = []
    if result is not None:
        definition = _PlainReturns(result).visit(definition)
    unpack = [f'{name} = {_unpacked(name, record)}' for name, record in records.items() if record]
    first = 0 if ast.get_docstring(definition) is None else 1
    definition.body[first:first] = ast.parse('\n'.join(unpack)).body
    ast.fix_missing_locations(tree)
    ast.increment_lineno(tree, function.__code__.co_firstlineno - 1)
    scope: dict[str, Any] = {}
    code = compile(tree, function.__code__.co_filename, 'exec', dont_inherit=True,
                   flags=__future__.annotations.compiler_flag)
    names = {cls.__name__: cls for record in records.values() for cls in _classes(record).values()}
    exec(code, {**names, **function.__globals__}, scope)
    return scope[function.__name__]


class _PlainReturns(ast.NodeTransformer):
    """Makes `return x` return the plain tuple of a NamedTuple x."""

    def __init__(self, record: Any) -> None:
        self._plain = ast.parse(f'returned = 0\nreturn {_packed("returned", record)}').body

    def visit_Return(self, node: ast.Return) -> list[ast.stmt]:
        assert node.value is not None
        assignment, answer = copy.deepcopy(self._plain)
        assert isinstance(assignment, ast.Assign)
        assignment.value = node.value
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
    with _keeping() as kept:
        dispatcher = numba.njit(
            arguments, cache=kept, error_model='numpy', no_cfunc_wrapper=True, **options,
        )(function)
    if dispatcher.stats.cache_misses:
        _say_once()
        if kept:
            seal(Path(dispatcher.stats.cache_path), f'.{function.__qualname__}-')
    return dispatcher


def _say_once() -> None:
    if not _told:
        _told.append(True)
        print('redundant_planner: compiling its mathematics, once per installation; this takes '
              'about half a minute', file=sys.stderr, flush=True)


_told: list[bool] = []


def _argument_type(name: str, scope: dict[str, object]) -> types.Type:
    if name in _SCALARS:
        return _SCALARS[name]
    if name in _ARRAYS:
        dtype, dimensions = _ARRAYS[name]
        return types.Array(dtype, dimensions, 'A', readonly=not name.startswith('Out'))
    if name.startswith('Fields['):
        plain = _tuple_type(scope[name[len('Fields['):-1]])
        return types.Tuple(plain.types)
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
    before, folder = numba.config.CACHE_DIR, _folder()
    numba.config.CACHE_DIR = str(folder or '')
    try:
        yield folder is not None
    finally:
        numba.config.CACHE_DIR = before


@functools.cache
def _folder() -> Path | None:
    """Return this version's folder, with nothing in it that is damaged; None if there is none."""
    here = Path(__file__).parent
    sources = b''.join(path.read_bytes() for path in sorted(here.rglob('*.py')))
    name = f'compiled-{zlib.crc32(sources):08x}'
    beside = here / '__pycache__'
    # Nobody else keeps anything here: what is left is of other versions.
    for other in beside.glob('compiled-*'):
        if other.name != name:
            shutil.rmtree(other, ignore_errors=True)
    # NUMBA_CACHE_DIR is somebody's wish.
    wished = [Path(numba.config.CACHE_DIR)] if numba.config.CACHE_DIR else []
    for parent in (*wished, beside, cache_folder()):
        if parent is not None and _private(parent / name):
            drop_damaged(parent / name)
            return parent / name
    return None


def _private(folder: Path) -> bool:
    """Make a folder; return whether it is there and nobody but this user can write to it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
    except OSError:
        return False
    return (status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
            and os.access(folder, os.W_OK))


# Numba runs whatever it finds in its files. Beside each of them lies its checksum.
_SEAL = '.sum'
_KEPT = ('*.nbi', '*.nbc')


def seal(folder: Path, part: str) -> None:
    """Write the checksums of a folder's files that have `part` in their name."""
    for file in (file for kind in _KEPT for file in folder.glob(kind) if part in file.name):
        with contextlib.suppress(OSError):  # another process has just replaced it
            beside = file.with_name(f'{file.name}{_SEAL}.{os.getpid()}')
            beside.write_text(_checksum(file))
            beside.replace(file.with_name(file.name + _SEAL))


def drop_damaged(folder: Path) -> None:
    """Delete the files below a folder that are not as they were written: cut, empty, altered."""
    for file in (file for kind in _KEPT for file in folder.rglob(kind)):
        try:
            sound = file.with_name(file.name + _SEAL).read_text() == _checksum(file)
        except (OSError, ValueError):
            sound = False
        if not sound:
            with contextlib.suppress(OSError):
                file.unlink()


def _checksum(file: Path) -> str:
    return hashlib.blake2b(file.read_bytes()).hexdigest()

"""A few functions of all kinds, compiled in a process of its own that calls `main`.

Its argument is what is wrong with Numba, a function of this module. It prints as JSON what the
functions compute, whether they notice a write past the end, and whether they came from the cache.
"""

from __future__ import annotations

import inspect
import json
import sys
from types import ModuleType
from typing import NamedTuple

import numba
from numba.core import base, bytecode, dispatcher
from numba.np import arrayobj
import numpy as np


def nothing() -> None:
    """Leave Numba as it is."""


def newer() -> None:
    """Have a version that nobody has tried."""
    numba.__version__ = '99.1.0rc1'


def moved() -> None:
    """Have `populate_array` elsewhere; Numba itself knows where."""
    _arrayobj_with({})


def turned() -> None:
    """Have `populate_array` take strides in the other order."""
    _arrayobj_with({'populate_array': lambda array, data, shape, strides, itemsize, owner:
                    arrayobj.populate_array(array, data, shape, strides[::-1], itemsize, owner)})


def _arrayobj_with(others: dict[str, object]) -> None:
    """Have another module where this package imports from; Numba keeps its own."""
    module = ModuleType('numba.np.arrayobj')
    kept = {name: value for name, value in vars(arrayobj).items() if name != 'populate_array'}
    vars(module).update(kept | others)
    sys.modules['numba.np.arrayobj'] = module


def renamed() -> None:
    """Have functions numbered by another counter."""
    identity = bytecode.FunctionIdentity
    source = inspect.cleandoc('\n' + inspect.getsource(identity.from_function.__func__))
    scope: dict[str, object] = {}
    exec(source.replace('_unique_ids', '_numbers'), vars(bytecode), scope)
    identity._numbers = identity._unique_ids
    identity.from_function = scope['from_function']
    del identity._unique_ids


def ignored() -> None:
    """Have the counter there, and another one used."""
    counter = bytecode.FunctionIdentity._unique_ids
    renamed()
    bytecode.FunctionIdentity._unique_ids = counter


def demanding() -> None:
    """Have another argument needed where functions are inserted; Numba itself gives it."""
    before = base.BaseContext.insert_user_function

    def insert(context: object, function: object, description: object, libraries: object) -> None:
        before(context, function, description, libraries)

    base.BaseContext.insert_user_function = insert


def uncached() -> None:
    """Have the cache's folder set elsewhere, and no statistics of it."""
    newer()
    del numba.config.CACHE_DIR
    del dispatcher.Dispatcher.stats


# Before this package is imported.
globals()[sys.argv[1]]()

from redundant_planner.core.kernels import compiled, entry, kernel, Matrix, OutVector, Vector  # noqa: E402  # noqa: E402
from redundant_planner.core.machine_code.packed import Packed  # noqa: E402


class Pair(NamedTuple):
    first: Vector
    second: Vector


class Setup(NamedTuple):
    grid: Matrix
    pair: Pair
    count: int
    used: bool


class Both(NamedTuple):
    pair: Pair
    sums: Vector
    total: float


@kernel
def dot(a: Vector, b: Vector) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@compiled
def swapped(pair: Pair, factor: float) -> Pair:
    """Return an argument, and something new."""
    return Pair(pair.second, factor * pair.first)


@compiled
def fill(pair: Pair, out: OutVector) -> None:
    for i in range(len(out)):
        out[i] = dot(pair.first, pair.second) / i


@entry
def use(setup: Packed[Setup], pair: Pair, plain: Vector, out: OutVector) -> Both:
    """Write to arrays, and return some that are borrowed."""
    grid = setup.value.grid
    fill(pair, out)
    grid[0, 1] = out[1]
    found = swapped(setup.value.pair, float(setup.value.count))
    if setup.value.used:
        return Both(found, grid[1], dot(plain, plain))
    return Both(Pair(plain, plain), grid[:, 1], np.sqrt(2.0))


@kernel
def put_inlined(values: OutVector, at: int) -> None:
    values[at] = 7.0


@compiled
def put_called(values: OutVector, at: int) -> None:
    put_inlined(values, at)


@entry
def put_entered(packed: Packed[Pair], at: int) -> None:
    packed.value.first[at] = 7.0


def notices() -> list[bool]:
    """Return whether a write past the end is an error: what lies behind it is there, too."""
    whole, packed = np.zeros(4), Packed.of(Pair(np.zeros(3), np.zeros(3)))
    found = []
    for put, values, behind in ((put_called, whole[:3], whole[3:]),
                                (put_entered, packed, packed.value.second)):
        put(values, 2)
        try:
            put(values, 3)
            found.append(False)
        except IndexError:
            found.append(True)
        assert (behind[0] == 0.0) == found[-1]
    return found


def main() -> None:
    random = np.random.default_rng(0)
    answers = []
    for used in (True, False):
        pair = Pair(random.normal(size=3), random.normal(size=3))
        packed = Packed.of(Setup(random.normal(size=(2, 5))[:, ::2], pair, 3, used))
        plain, out = np.arange(6.0)[::2], np.empty(3)
        for _ in range(2):
            found = use(packed, pair, plain, out)
            borrowed = (*pair, plain, packed.numbers)
            assert not any(np.shares_memory(a, b) for a in (*found.pair, found.sums)
                           for b in borrowed)
        answers += [*found.pair, found.sums, found.total, out, packed.value.grid]
        back = swapped(pair, 2.0)
        assert not any(np.shares_memory(a, b) for a in back for b in pair)
        answers += [*back]
    try:
        use(Packed.of(pair), pair, plain, out)
    except TypeError as error:
        answers.append(str(error))
    stats = getattr(swapped, 'stats', None)
    print(json.dumps({'answers': [np.asarray(answer).tolist() for answer in answers],
                      'notices': notices(),
                      'kept': stats is not None and not stats.cache_misses}))

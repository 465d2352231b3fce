"""What is compiled does what it says in Python, for the types that it names."""

from __future__ import annotations

import itertools
import json
import os
from pathlib import Path
import subprocess
import sys
from typing import NamedTuple

from conftest import make_panda, PANDA_READY
import numpy as np
import pytest

import redundant_planner
from redundant_planner import compile
from redundant_planner.core.kernels import (
    compiled,
    entry,
    IndexPairs,
    Indices,
    Matrix,
    OutVector,
    Stack,
    Vector,
)
from redundant_planner.core.machine_code.packed import Packed
from redundant_planner.core.machine_code_cache import drop_damaged, is_private, seal
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import LinkPairs
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner


def motion(method: str) -> list[list[float]]:
    """Joint velocities of an arm that runs into an obstacle, limits and its own braking."""
    robot = make_panda()
    planner = Planner(robot, PlannerParameters(
        method=method, horizon_nodes=4, clearance_influence_distance=0.4))
    scene = Scene.of([
        Obstacle('ball', np.array([0.45, 0.05, 0.45]), np.array([0.05, 0.04, 0.08])),
        Obstacle('other', np.array([0.3, -0.4, 0.6]), np.full(3, 0.1), velocity=(0.1, 0.2, 0))])
    q, rows = PANDA_READY.copy(), []
    for i in range(40):
        twist = np.array([0.3, 0.2, -0.1, 0.1, 0.0, 0.4]) if i < 30 else np.zeros(6)
        dq = planner.step(q, twist, scene, 0.02).dq
        q = q + 0.02 * dq
        rows.append(dq.tolist())
    return rows


@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
def test_machine_code_does_what_the_python_does(method):
    code = f'import json, test_kernels; print(json.dumps(test_kernels.motion({method!r})))'
    here = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=True,
        env={**os.environ, 'NUMBA_DISABLE_JIT': '1',
             'PYTHONPATH': os.pathsep.join((str(here), str(here.parent), *sys.path))})
    np.testing.assert_allclose(motion(method), json.loads(done.stdout), atol=1e-7)


def test_a_wrong_type_is_an_error_and_never_compiled_for():
    @compiled
    def total(values: Vector) -> float:
        return values.sum()

    assert total(np.arange(3.0)) == 3.0
    read_only = np.arange(6.0)[::2]
    read_only.setflags(write=False)
    assert total(read_only) == 6.0
    for wrong in (np.arange(3), np.zeros((2, 2)), [1.0]):
        with pytest.raises(TypeError):
            total(wrong)


class Halves(NamedTuple):
    first: Vector
    second: Vector


class Split(NamedTuple):
    halves: Halves
    total: float


@pytest.mark.long
def test_records_cross_over_to_an_entry_and_back():
    @entry
    def split(pair: Halves, share: float) -> Split:
        """Take a share of both."""
        if share == 1.0:
            return Split(pair, pair.first.sum() + pair.second.sum())
        halves = Halves(share * pair.first, share * pair.second)
        return Split(halves, halves.first.sum() + halves.second.sum())

    pair = Halves(np.arange(3.0), np.ones(3))
    for share in (1.0, 0.5):
        found = split(pair, share)
        assert isinstance(found, Split) and isinstance(found.halves, Halves)
        np.testing.assert_array_equal(found.halves, share * np.array(pair))
        assert found.total == split(pair=pair, share=share).total == share * 6.0
    assert split.__doc__ == 'Take a share of both.'
    for wrong in ((pair, np.ones(1)), (Halves(np.arange(3), np.ones(3)), 1.0)):
        with pytest.raises(TypeError):
            split(*wrong)


class Names(NamedTuple):
    rows: Indices
    pairs: IndexPairs
    used: bool
    count: int


class Lot(NamedTuple):
    halves: Halves
    grid: Matrix
    names: Names
    stack: Stack
    share: float


@pytest.mark.long
def test_what_is_packed_crosses_over_whole_and_shows_what_is_written():
    @entry
    def use(lot: Packed[Lot], first: float) -> Lot:
        """Write to an array and return all that is in it."""
        halves, grid, names, stack, share = lot.value
        halves.second[0] = first
        return Lot(halves, 2.0 * grid, names, stack, share)

    random = np.random.default_rng(0)
    for k in (0, 1, 4):
        halves = Halves(random.normal(size=k), random.normal(size=3))
        names = Names(random.integers(9, size=k), random.integers(9, size=(k, 2)), k > 0, k - 1)
        lot = Lot(halves, random.normal(size=(2, 5))[:, ::2], names,
                  random.normal(size=(k, 3, 2)), 0.25 * k)
        packed = Packed.of(lot)
        for part in (packed.value.halves, packed.value.names[:2], packed.value[1::2]):
            assert all(np.shares_memory(entry, packed.numbers) or np.shares_memory(
                entry, packed.integers) or entry.size == 0 for entry in part)
        found = use(packed, 7.0)
        assert halves.second[0] != 7.0 == packed.value.halves.second[0]
        halves.second[0] = 7.0
        for given, there, back in zip(
                (*halves, 2.0 * lot.grid, *names, lot.stack, lot.share),
                (*packed.value.halves, 2.0 * packed.value.grid, *packed.value.names,
                 *packed.value[3:]),
                (*found.halves, found.grid, *found.names, *found[3:]), strict=True):
            np.testing.assert_array_equal(there, given)
            np.testing.assert_array_equal(back, given)
            assert type(there) is type(given)
        packed.numbers[:], packed.integers[:] = -1.0, -1  # what came back is the caller's to keep
        np.testing.assert_array_equal(found.stack, lot.stack)
        np.testing.assert_array_equal(found.names.pairs, names.pairs)


@pytest.mark.parametrize('other', [
    Halves(np.arange(3.0), np.ones((2, 2))), Halves(np.arange(3.0), np.arange(2)),
    Split(Halves(np.arange(3.0), np.arange(2.0)), 1.0)])
def test_what_else_is_packed_is_an_error(other):
    @entry
    def total(pair: Packed[Halves]) -> float:
        return pair.value.first.sum() + pair.value.second.sum()

    pair = Halves(np.arange(3.0), np.arange(2.0))
    assert total(Packed.of(pair)) == 4.0
    with pytest.raises(TypeError, match='argument pair must be a packed Halves'):
        total(Packed.of(other))
    with pytest.raises(AttributeError):
        total(pair)


@compiled
def same(pair: Halves, share: float) -> tuple[Halves, Vector]:
    """Return two halves as they are, or a share of them."""
    if share == 1.0:
        return pair, pair.second[1:]
    return Halves(share * pair.first, share * pair.second), pair.second[1:]


@compiled
def doubled(values: Vector, share: float) -> tuple[Halves, Vector]:
    """Return what `same` does of arrays that live no longer than this call."""
    twice = values * 2.0
    return same(Halves(twice, twice), share)


@pytest.mark.parametrize('share', [1.0, 0.5])
def test_what_a_compiled_function_returns_is_the_callers_to_keep(share):
    pair = Halves(np.arange(3.0), np.arange(4.0))
    found, rest = same(pair, share)
    twice, end = doubled(np.arange(3.0), share)
    for taken in pair:
        taken[:] = -1.0
    [np.full(3, -2.0) for _ in range(1000)]  # would take the place of arrays that were given up
    np.testing.assert_array_equal(found.first, share * np.arange(3.0))
    np.testing.assert_array_equal(found.second, share * np.arange(4.0))
    np.testing.assert_array_equal(rest, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(twice, [2.0 * share * np.arange(3.0)] * 2)
    np.testing.assert_array_equal(end, [2.0, 4.0])


@pytest.mark.long
def test_what_an_entry_returns_is_the_callers_to_keep():
    @entry
    def parts(pair: Halves, plain: Vector) -> Halves:
        return Halves(pair.first, pair.second[1:3])

    @entry
    def middle(pair: Halves, plain: Vector) -> Vector:
        return plain[1:3]

    @entry
    def fill(pair: Halves, out: OutVector) -> None:
        out[:] = pair.first

    pair, plain = Halves(np.arange(3.0), np.arange(4.0)), np.arange(8.0)[::2]
    kept = (*parts(pair, plain), middle(pair, plain))
    for taken in (*pair, plain):
        taken[:] = -1.0
    for found, expected in zip(kept, ([0.0, 1.0, 2.0], [1.0, 2.0], [2.0, 4.0]), strict=True):
        assert found.base is not None or found.flags.owndata
        np.testing.assert_array_equal(found, expected)
    fill(pair, kept[0])  # where Python's own arrays are to be filled, they are
    np.testing.assert_array_equal(kept[0], pair.first)


def test_records_go_into_compiled_functions_and_arrays_can_be_filled():
    @compiled
    def fill(pairs: LinkPairs, weights: Matrix, result: OutVector) -> float:
        for i in range(len(result)):
            result[i] = weights[i, 0] * pairs.distance[i] + pairs.points[i, 0, 0]
        return 1.0 / weights[0, 1]

    result = np.empty(2)
    assert fill(LinkPairs(np.array([1.0, 2.0]), np.ones((2, 2, 3))),
                np.array([[2.0, 0.0], [3.0, 0.0]]), result) == np.inf
    np.testing.assert_array_equal(result, [3.0, 7.0])


def spoil(file, how):
    content = file.read_bytes()
    file.write_bytes({
        'empty': b'', 'cut': content[:len(content) // 2],
        'altered': content[:-9] + bytes([content[-9] ^ 255]) + content[-8:]}[how])


@pytest.mark.parametrize('how', ['empty', 'cut', 'altered', 'unsealed'])
def test_damaged_machine_code_is_not_kept(tmp_path, how):
    for name in ('a.one-1.py312.nbi', 'a.one-1.py312.1.nbc', 'a.other-9.py312.nbi'):
        (tmp_path / name).write_bytes(b'machine code')
    seal(tmp_path, '.one-')
    seal(tmp_path, '.other-')
    drop_damaged(tmp_path)
    assert len(list(tmp_path.glob('*.nb?'))) == 3
    bad = tmp_path / 'a.one-1.py312.1.nbc'
    if how == 'unsealed':
        bad.with_name(bad.name + '.sum').unlink()
    else:
        spoil(bad, how)
    drop_damaged(tmp_path)
    assert not bad.exists() and len(list(tmp_path.glob('*.nb?'))) == 2


@pytest.mark.long
def test_a_start_with_damaged_machine_code_compiles_it_anew(tmp_path):
    """Each kept file of a module spoilt in some way; the module works, and is kept again."""
    code = ('import numpy as np; from redundant_planner.core.robot import jacobian; '
            'print(jacobian.derivative_times.stats)')

    def start():
        done = subprocess.run(
            [sys.executable, '-c', code], capture_output=True, text=True, check=True,
            env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)})
        return done.stdout, done.stderr

    assert 'compiling' in start()[1]
    said, complaint = start()
    assert not complaint and 'cache_misses=Counter()' in said
    files = sorted(file for kind in ('*.nbi', '*.nbc') for file in tmp_path.rglob(kind))
    assert len(files) >= 6
    for file, how in zip(files, itertools.cycle(['empty', 'cut', 'altered'])):
        spoil(file, how)
    assert 'compiling' in start()[1]
    assert not start()[1]


@pytest.mark.long
@pytest.mark.parametrize('lost', ['null_space', 'criteria'])
def test_machine_code_of_two_processes_fits_together(tmp_path, lost):
    """One process keeps a function, another the one that it calls."""
    code = ('import sys, numpy as np; from importlib import import_module\n'
            'for name in sys.argv[1:]: import_module(f"redundant_planner.core.{name}")\n'
            'from redundant_planner.core.redundancy import criteria, null_space\n'
            'parts = null_space.decompose(np.linspace(0.0, 1.0, 42).reshape(6, 7) ** 2)\n'
            'print(criteria.manipulability_index(parts, np.ones((6, 7))))')

    def start(*first):
        done = subprocess.run(
            [sys.executable, '-c', code, *first], capture_output=True, text=True, check=True,
            env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)})
        return done.stdout, done.stderr

    said, _ = start()
    lost_files = list(tmp_path.rglob(f'{lost}.*.nb?'))
    assert lost_files
    for file in lost_files:
        file.unlink()
    again, complaint = start('robot.cone')
    assert 'compiling' in complaint and again == said
    assert start() == (said, '')


@pytest.mark.parametrize('mode', [0o777, 0o770])
def test_machine_code_that_others_can_write_is_not_loaded(tmp_path, mode):
    folder = tmp_path / 'kept'
    folder.mkdir()
    assert is_private(folder)
    folder.chmod(mode)
    assert not is_private(folder)
    (tmp_path / 'file').touch()
    assert not is_private(tmp_path / 'file' / 'below')


@pytest.mark.long
def test_compile_knows_every_module_with_compiled_functions():
    """What it leaves out would be compiled at the first start of a node."""
    package = Path(redundant_planner.__file__).parent
    named = [f'redundant_planner.{name}' for lanes in compile.STEPS for lane in lanes
             for name in lane]
    code = f'import {", ".join(named)}, sys; print(*sys.modules)'
    loaded = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                            check=True).stdout.split()
    for file in package.rglob('*.py'):
        if {'@compiled', '@entry', '@kernel'} & set(file.read_text().splitlines()):
            parts = file.relative_to(package).with_suffix('').parts
            assert '.'.join(('redundant_planner', *parts)) in loaded

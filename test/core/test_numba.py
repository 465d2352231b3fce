"""A Numba that nobody has tried ends no start, and checked code is told from unchecked."""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

import pytest

from redundant_planner.core import machine_code_cache, planner
from redundant_planner.core.machine_code.choice import untested
from redundant_planner.core.machine_code_cache import compiled_sources, machine_code_folder


def start(cache: Path, broken: str = 'nothing', checks: str = '0') -> tuple[Any, list[str]]:
    """Return what `few_compiled` found, and the lines of its complaint."""
    here = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, '-c', 'import few_compiled; few_compiled.main()', broken],
        capture_output=True, text=True, check=True,
        env={**os.environ, 'NUMBA_CACHE_DIR': str(cache), 'NUMBA_BOUNDSCHECK': checks,
             'PYTHONPATH': os.pathsep.join((str(here), *sys.path))})
    return json.loads(done.stdout), [line for line in done.stderr.splitlines()
                                     if 'compiling its mathematics' not in line]


@pytest.fixture(scope='module')
def ordinary(tmp_path_factory) -> Any:
    found, complaint = start(tmp_path_factory.mktemp('ordinary'))
    assert not complaint
    return found


@pytest.mark.long
@pytest.mark.parametrize('broken, reason', [
    ('newer', 'Numba 99.1.0rc1 has not been tried'),
    ('moved', "ImportError: cannot import name 'populate_array'"),
    ('turned', 'its machine code computes something else'),
    ('renamed', "has no attribute '_unique_ids'"),
    ('ignored', 'its machine code bears other names'),
    ('demanding', "missing 1 required positional argument: 'libraries'"),
])
def test_with_another_numba_functions_are_compiled_plainly(tmp_path, ordinary, broken, reason):
    """The same answers to the last bit, one line that says so, and kept for the next start."""
    found, complaint = start(tmp_path, broken)
    assert found == ordinary
    assert not ordinary['kept']
    (line,) = complaint
    assert reason in line and "pip install 'numba>=" in line and 'times as long' in line
    again, _ = start(tmp_path, broken)
    assert again == {**ordinary, 'kept': True}


@pytest.mark.long
def test_where_machine_code_cannot_be_kept_it_is_compiled_at_each_start(tmp_path, ordinary):
    for _ in range(2):
        found, complaint = start(tmp_path, 'uncached')
        assert found == ordinary and len(complaint) == 1
    assert not list(tmp_path.rglob('*.nb?'))


@pytest.mark.long
def test_checked_machine_code_is_not_taken_for_unchecked_nor_plain(tmp_path, ordinary):
    """All kinds side by side in one folder, each compiled once."""
    assert ordinary['notices'] == [False, False]
    kinds = [('nothing', '0'), ('nothing', '1'), ('newer', '0'), ('newer', '1')]
    for kept in (False, True):
        for broken, checks in kinds:
            found, _ = start(tmp_path, broken, checks)
            assert found == {**ordinary, 'kept': kept, 'notices': 2 * [checks == '1']}


@pytest.mark.parametrize('version', ['0.59.0', '0.59.1', '0.68.1', '0.68.0rc1', '0.61.2+local'])
def test_versions_in_the_range_are_tried(version):
    assert untested(version) is None


@pytest.mark.parametrize('version', ['0.58.1', '0.69.0', '0.69.0dev0+8.gabc', '1.0.0', '0', ''])
def test_others_are_not(version):
    assert untested(version) == f'Numba {version} has not been tried'


IMPORTS_LIMITS = 'from redundant_planner.core.limits import (\n    first,\n)\n'


def test_machine_code_is_of_all_that_compiled_functions_can_see():
    """What their modules have imported lies in a file that the folder's name stands for."""
    core = Path(machine_code_cache.__file__).parent
    assert planner.__name__ in sys.modules  # and with it all of core
    sources = compiled_sources(core).decode()
    seen = [module for name, module in sorted(sys.modules.items())
            if name.startswith('redundant_planner.core.')
            and Path(module.__file__).read_text() in sources]
    assert 40 < len(seen) < len(list(core.rglob('*.py'))) - 20
    for module in seen:
        for value in vars(module).values():
            home = sys.modules.get(getattr(value, '__module__', None) or '', value)
            if getattr(home, '__name__', '').startswith('redundant_planner.core.'):
                assert Path(home.__file__).read_text() in sources, (module, value)


def test_folders_of_other_versions_go_and_those_of_this_one_stay(tmp_path, monkeypatch):
    """Of a copy of what makes the folder: the real one may be in use."""
    sources = tmp_path / 'core'
    (sources / '__pycache__').mkdir(parents=True)
    monkeypatch.setattr('redundant_planner.core.machine_code_cache.__file__',
                        str(sources / 'machine_code_cache.py'))
    (sources / 'tick.py').write_text(f'{IMPORTS_LIMITS}@entry\ndef tick(): ...\n')
    (sources / 'limits.py').write_text('first = 1\n')
    first = [machine_code_folder.__wrapped__('', how) for how in ('', '-checked', '-plain')]
    assert len(set(first)) == 3 and all(folder.is_dir() for folder in first)
    (sources / 'planner.py').write_text('says = "another comment"\n')
    assert machine_code_folder.__wrapped__('', '') == first[0]
    (sources / 'limits.py').write_text('second = 2\n')
    second = machine_code_folder.__wrapped__('', '-checked')
    assert second.is_dir() and not any(folder.exists() for folder in first)
    assert machine_code_folder.__wrapped__('', '') not in first and second.is_dir()

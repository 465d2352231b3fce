"""The fuzzer outlives what it attacks: a death is counted, named, and not the end of the run."""

from __future__ import annotations

import json
from pathlib import Path
import re
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parent.parent

# Attack 3 ends its process, others count an input; `lives` shows what a process has run so far.
_RUN = """
import ctypes, os, sys
import benchmark.fuzz.__main__ as fuzz

lives = []

def attack(random, folder, tally):
    lives.append(tally.attack)
    (folder / 'left behind').write_text('x')
    tally.attempt(lambda: None)
    if tally.attack == 3:
        sys.stderr.write('last words\\n')
        sys.stderr.flush()
        {deed}
    # As if it counted what it draws, and how many came before it in its process.
    tally.kinds[f'{{tally.attack}} {{random.integers(1 << 30)}} {{len(lives)}}'] += 1

fuzz.attack_of = lambda kind: attack
raise SystemExit(fuzz.main(sys.argv[1:]))
"""


def _fuzz(deed: str, file: Path, *options: str) -> tuple[int, str, dict]:
    run = subprocess.run(
        [sys.executable, '-c', _RUN.format(deed=deed), '--seed', '7', '--json', str(file),
         *options],
        cwd=ROOT, capture_output=True, text=True, timeout=60.0)
    return run.returncode, run.stdout, json.loads(file.read_text())


DEATHS = pytest.mark.parametrize(('deed', 'how'), [
    ('os.abort()', 'SIGABRT'), ('ctypes.string_at(0)', 'SIGSEGV'),
    ('os._exit(3)', 'exit status 3'), ('os._exit(0)', 'exit status 0'),
    ('raise SystemExit(5)', 'exit status 5'), ('os.kill(os.getpid(), 9)', 'SIGKILL')])


@DEATHS
def test_a_death_is_a_finding_and_the_run_goes_on(deed, how, tmp_path):
    status, said, counts = _fuzz(deed, tmp_path / 'f.json', '--what', 'files', '--minutes', '0.01')
    assert status == 1
    assert counts['deaths'] == counts['kinds']['files']['deaths'] == 1
    assert f'files, seed 7: death by {how}, attack 3' in said and 'last words' in said
    # Every other attack counts once, and the process after the death begins with the next one.
    drawn = [list(map(int, entry.split())) for entry in counts['kinds']['files']['exceptions']]
    numbers = [number for number, _, _ in drawn]
    assert len(numbers) > 10 and numbers == [n for n in range(numbers[-1] + 1) if n != 3]
    assert counts['inputs'] == len(numbers)
    assert [before for _, _, before in drawn] == [
        n + 1 if n < 3 else n - 3 for n in numbers]


def test_an_attack_depends_on_its_number_alone(tmp_path):
    several = _fuzz('os.abort()', tmp_path / 'f.json', '--what', 'bags', '--minutes', '0.01')[2]
    drawn = dict(entry.split()[:2] for entry in several['kinds']['bags']['exceptions'])
    for number in ('0', '4', '5'):
        status, _, alone = _fuzz(
            'os.abort()', tmp_path / 'f.json', '--what', 'bags', '--at', number)
        entry, = alone['kinds']['bags']['exceptions']
        assert status == 0 and entry.split()[:2] == [number, drawn[number]]


def test_a_death_alone_is_told_as_well(tmp_path):
    status, said, counts = _fuzz('os.abort()', tmp_path / 'f.json', '--what', 'core', '--at', '3')
    assert status == 1 and counts['deaths'] == 1
    assert re.search(r'core, seed 7: death by SIGABRT, attack 3', said)


def test_what_hangs_is_killed_and_counts_as_a_death(tmp_path):
    deed = 'import time; time.sleep(1e6)'
    script = _RUN.format(deed=deed).replace(
        'lives = []', 'import benchmark.fuzz.child as c; c._LONGEST_ATTACK = 1.0; lives = []')
    run = subprocess.run([sys.executable, '-c', script, '--what', 'core', '--at', '3'], cwd=ROOT,
                         capture_output=True, text=True, timeout=60.0)
    assert run.returncode == 1 and 'death by hanging for 1 s, attack 3' in run.stdout
    assert 'in attack' in run.stdout  # where it hung

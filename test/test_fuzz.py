"""The fuzzer outlives what it attacks: a death is counted, named, and not the end of the run."""

from __future__ import annotations

import json
from pathlib import Path
import re
import subprocess
import sys

from conftest import make_planar
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmark.fuzz import attack_core
from benchmark.fuzz.motion_judge import MotionJudge
from benchmark.fuzz.random_arms import random_arm
from benchmark.fuzz.tally import Tally

ROOT = Path(__file__).resolve().parent.parent

# Attack 3 ends its process, others count an input; `lives` shows what a process has run so far.
# By the clock, every attack takes a twelfth of the time.
_RUN = """
import ctypes, itertools, os, sys, types
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
fuzz.time = types.SimpleNamespace(monotonic=itertools.count(0, 5).__next__)
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


@pytest.mark.first_alone
@DEATHS
def test_a_death_is_a_finding_and_the_run_goes_on(deed, how, tmp_path):
    status, said, counts = _fuzz(deed, tmp_path / 'f.json', '--what', 'files', '--minutes', '1')
    assert status == 1
    assert counts['deaths'] == counts['kinds']['files']['deaths'] == 1
    assert f'files, seed 7: death by {how}, attack 3' in said and 'last words' in said
    # Every other attack counts once, and the process after the death begins with the next one.
    drawn = [list(map(int, entry.split())) for entry in counts['kinds']['files']['exceptions']]
    numbers = [number for number, _, _ in drawn]
    assert numbers == [n for n in range(12) if n != 3]
    assert counts['inputs'] == len(numbers)
    assert [before for _, _, before in drawn] == [
        n + 1 if n < 3 else n - 3 for n in numbers]


@pytest.mark.long
def test_an_attack_depends_on_its_number_alone(tmp_path):
    several = _fuzz('os.abort()', tmp_path / 'f.json', '--what', 'bags', '--minutes', '1')[2]
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


def test_the_judge_tells_which_limit_is_exceeded():
    robot = make_planar(
        velocity_max=(1.0,), acceleration_max=(2.0,), jerk_max=(100.0,), link_radius=0.0)
    rest = np.zeros(robot.n)

    def first(*velocities, dt=0.01, q=rest, jerk_kept=True):
        """Return how many of the velocities of the first joint were carried out, and the fault."""
        judge, tally = MotionJudge(robot, q), Tally()
        for count, velocity in enumerate(velocities):
            if not judge.carry_out(velocity * np.eye(robot.n)[0], dt, tally, jerk_kept=jerk_kept):
                assert tally.limit_violations == 1
                return count, next(iter(tally.first)).split()[0]
        assert tally.clean
        return len(velocities), ''

    even = [0.02 * i for i in range(51)]  # 2 rad/s²
    assert first(*even, 1.0, 1.0, jerk_kept=False) == (53, '')
    assert first(*even, 1.02, jerk_kept=False) == (51, 'velocity')
    assert first(0.0, 0.021) == (1, 'acceleration')
    assert first(0.021, dt=0.02) == (1, '')  # a longer tick may change more
    # 100 rad/s³ is 1 rad/s² more in each tick, once the window of 4 ticks has been forgotten.
    still = [0.0] * 10
    assert first(*still, 0.01, 0.03, 0.05) == (13, '')
    assert first(*still, 0.015) == (10, 'jerk')
    assert first(*still, 0.015, jerk_kept=False) == (11, '')
    high = np.where(np.isfinite(robot.position_max), robot.position_max, 0.0)
    near = high - 1e-4
    assert first(0.005, 0.01, q=near) == (1, 'position')
    beyond = high + 0.1
    assert first(0.001, q=beyond) == (0, 'position')
    assert first(0.0, -0.02, -0.04, q=beyond) == (3, '')


@pytest.mark.long
def test_random_arms_are_of_all_kinds_and_depend_on_their_seed():
    arms = [random_arm(np.random.default_rng(seed)) for seed in range(30)]
    assert {arm.n for arm in arms} >= {3, 14} and {arm.m for arm in arms} == {1, 2, 3, 4, 5, 6}
    assert {len(arm.self_pairs) > 20 for arm in arms} == {False, True}
    for seed, arm in enumerate(arms):
        again = random_arm(np.random.default_rng(seed))
        assert arm.urdf == again.urdf and arm.axes == again.axes
        np.testing.assert_array_equal(arm.acceleration_max, again.acceleration_max)
        np.testing.assert_array_equal(arm.self_pairs, again.self_pairs)


@pytest.mark.long
def test_an_attack_on_the_mathematics_does_not_depend_on_those_before(tmp_path):
    def run(number):
        random, tally = np.random.default_rng((4, number)), Tally(number)
        attack_core.attack(random, tmp_path, tally)
        return tally, random.bit_generator.state

    first = [run(number) for number in range(3)]
    assert [run(number) for number in (2, 1, 0)] == first[::-1]

"""Every example runs as it stands, from any folder, and prints what it promises."""

from __future__ import annotations

from pathlib import Path
import re
import subprocess
import sys

from conftest import PANDA_URDF
import pytest

EXAMPLES = Path(__file__).resolve().parent.parent / 'examples'
ALL = sorted(path.name for path in EXAMPLES.glob('*.py'))


def run(name: str, folder: Path, *arguments: str) -> str:
    """Run an example in an empty folder; return its output."""
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *arguments], cwd=folder, text=True,
        capture_output=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert 'Warning' not in done.stderr, done.stderr
    return done.stdout


def repository() -> set[Path]:
    """The files of the repository where a careless example could leave something."""
    folders = (EXAMPLES, EXAMPLES.parent / 'config', EXAMPLES.parent / 'redundant_planner')
    # The tests that run beside this one have caches of their own.
    return {*(path for path in EXAMPLES.parent.iterdir() if not path.name.endswith('_cache')),
            *(path for folder in folders for path in folder.rglob('*')
              if '__pycache__' not in path.parts)}


def numbers(pattern: str, text: str) -> list[float]:
    return [float(number) for number in re.findall(pattern, text)]


def test_they_use_the_public_api_alone():
    for name in ALL:
        modules = set(re.findall(r'^\s*(?:from|import) ([\w.]+)', (EXAMPLES / name).read_text(),
                                 re.MULTILINE))
        assert modules <= {'redundant_planner', 'redundant_planner.analysis.style', 'numpy',
                           'matplotlib', 'matplotlib.pyplot', 'sys', 'importlib.metadata'}, name


def test_each_is_tested():
    tested = Path(__file__).read_text()
    assert [name for name in ALL if f"'{name}'" not in tested] == []


@pytest.mark.long
def test_rules_of_ones_own_are_kept_and_named(tmp_path):
    without, text = run('10_own_rules.py', tmp_path).split('\nwith rules', 1)
    assert numbers(r'elbow keeps (-?[\d.]+) mm', without)[0] < 0.0
    (elbow,), (aside,) = (numbers(pattern, text) for pattern in (
        r'elbow keeps (-?[\d.]+) mm', r'up to ([\d.]+)° aside'))
    assert 0.0 <= elbow < 1.0 and aside <= 35.0
    assert "the speed gave way: 'elbow outside the column'" in text


@pytest.mark.long
def test_a_twist_is_followed_at_more_than_the_margin(tmp_path):
    text = run('01_follow_a_twist.py', tmp_path)
    (clearance,) = numbers(r'smallest clearance: ([\d.]+) mm', text)
    assert 10.0 <= clearance < 20.0


@pytest.mark.long
def test_the_arm_stops_before_an_obstacle_and_says_why(tmp_path):
    text = run('02_obstacles.py', tmp_path)
    assert "near obstacle 'beam'" in text and '100% of the speed' in text
    assert re.search(r'4 s: +0% of the speed', text)
    assert numbers(r'smallest clearance: ([\d.]+) mm', text) == [20.0]
    assert numbers(r'off the path: ([\d.]+) mm', text) == [0.0]


@pytest.mark.long
def test_the_arm_evades_and_the_tool_stays_put(tmp_path):
    text = run('03_moving_obstacles.py', tmp_path)
    assert numbers(r'smallest clearance: ([\d.]+) mm', text)[0] > 10.0
    assert numbers(r'the tool moved ([\d.]+) mm', text)[0] < 0.1
    assert max(numbers(r'up to ([\d.]+)', text)) > 0.02


@pytest.mark.long
def test_knowing_the_twists_to_come_shortens_the_joint_path(tmp_path):
    text = run('04_preview.py', tmp_path)
    for what in (r'joint path ([\d.]+)', r'squared velocities ([\d.]+)'):
        blind, known = numbers(what, text)
        assert known < blind
    assert min(numbers(r'clearance ([\d.]+) mm', text)) >= 10.0


def test_the_tool_goes_to_a_pose(tmp_path):
    text = run('07_go_to_a_pose.py', tmp_path)
    distances = numbers(r'moving +([\d.]+) mm', text)
    assert len(distances) > 1 and distances == sorted(distances, reverse=True)
    (seconds,) = numbers(r'reached after ([\d.]+) s', text)
    assert seconds < 2.0 and numbers(r'off by ([\d.]+) mm', text)[0] < 0.3


def test_two_hands_go_their_ways_and_hold_an_object(tmp_path):
    text = run('09_two_hands.py', tmp_path)
    (seconds,) = numbers(r'both hands are there after ([\d.]+) s', text)
    assert seconds < 3.0
    assert numbers(r'rose by ([\d.]+) mm', text)[0] == pytest.approx(150.0, abs=1.0)
    assert numbers(r'between the hands it moved by ([\d.]+) mm', text)[0] < 0.2
    assert numbers(r'left hand moves by ([\d.]+)', text)[0] > 10.0
    assert numbers(r'right one by ([\d.]+)', text)[0] < 0.5


@pytest.mark.long
def test_the_chunks_of_a_policy_are_followed_without_a_jump(tmp_path):
    text = run('08_policy_chunks.py', tmp_path)
    assert max(numbers(r'moving, +([\d.]+) mrad', text)) < 30.0
    assert max(numbers(r'([\d.]+) s behind', text)) < 0.1
    assert numbers(r'largest acceleration: ([\d.]+)', text)[0] < 0.8


@pytest.mark.parametrize('given', [False, True])
def test_an_arm_of_your_own_plans_from_its_urdf(given, tmp_path):
    before = repository()
    text = run('05_your_own_arm.py', tmp_path,
               *((str(PANDA_URDF), 'panda_link8') if given else ()))
    assert f'7 joints from panda_link0 to panda_{"link8" if given else "hand"}' in text
    assert min(numbers(r'radius (\d+) mm', text)) > 10.0
    assert numbers(r'smallest clearance: ([\d.]+) mm', text)[0] >= 10.0
    assert numbers(r'off the path: ([\d.]+) mm', text)[0] < 0.1
    assert not list(tmp_path.iterdir()) and repository() == before


@pytest.mark.long
def test_without_an_arm_the_example_says_where_to_get_one(tmp_path):
    code = ('import importlib.metadata as metadata, runpy, sys\n'
            'def files(name): raise metadata.PackageNotFoundError(name)\n'
            'metadata.files = files\n'
            'del sys.argv[0]; runpy.run_path(sys.argv[0])')
    done = subprocess.run(
        [sys.executable, '-c', code, str(EXAMPLES / '05_your_own_arm.py')], cwd=tmp_path,
        text=True, capture_output=True, timeout=300, check=False)
    assert done.returncode == 1 and 'pip install example-robot-data' in done.stderr


@pytest.mark.long
def test_the_methods_are_compared_in_numbers_and_a_picture(tmp_path):
    text = run('06_compare_methods.py', tmp_path, 'methods.png')
    squared = dict(re.findall(r'^(\w+) +[\d.]+ +([\d.]+) +[\d.]+ mm$', text, re.MULTILINE))
    assert list(squared) == ['gradient_projection', 'dynamic_factor', 'variational']
    traditional, *ours = (float(value) for value in squared.values())
    assert max(ours) < 0.95 * traditional
    assert (tmp_path / 'methods.png').read_bytes().startswith(b'\x89PNG')

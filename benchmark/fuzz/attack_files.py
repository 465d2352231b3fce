"""Files: spoilt parameter and scenario files, and kept capsule fits."""

from __future__ import annotations

import functools
import os
from pathlib import Path

import numpy as np
import yaml

from benchmark.fuzz.mutations import pick, spoilt_bytes, spoilt_numbers, spoilt_tree
from benchmark.fuzz.tally import Tally
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.link_shapes import Fit, fitted_capsules
from redundant_planner.io.obstacle_entries import static_obstacles
from redundant_planner.io.parameter_files import read_parameter_file, settings_of
from redundant_planner.io.resources import share_directory
from redundant_planner.io.robot_files import load_robot
from redundant_planner.io.scenario import load_scenario

_STATIC = """
/**:
  ros__parameters:
    static_obstacles: [ball, wall]
    static_obstacle:
      ball: {center: [0.5, 0.0, 0.4], semi_axes: [0.1, 0.1, 0.1]}
      wall: {center: [0.0, 0.6, 0.4], semi_axes: [1.0, 0.05, 1.0], orientation: [0, 0, 0, 1]}
    influence_distance: .inf
    joint_weights: [1.0, 2.0]
"""
_BOMB = 'a: &a [1,2,3,4,5,6,7,8,9]\n' + ''.join(
    f'{new}: &{new} [{",".join([f"*{old}"] * 9)}]\n' for old, new in zip('abcdefghi', 'bcdefghij'))
_TEXTS = ('', '{}', '[]', 'null', '/**:', '[' * 10_000, '{a: ' * 5000, _BOMB, '&a [*a]', '\x00',
          '\ufeff', '--- \n---', f'/**: {{ros__parameters: {{axes: [{"a," * 9999}]}}}}',
          '/**: &a {ros__parameters: *a}', '/**: {ros__parameters: &a {capsule: *a, axes: [*a]}}')


def attack(random: np.random.Generator, folder: Path, tally: Tally) -> None:
    """Spoil a file of each kind, and read it."""
    os.environ['XDG_CACHE_HOME'] = str(folder)
    file = folder / 'spoilt.yaml'
    parameters = _spoilt(random, pick(random, (*_examples('robots'), *_examples('planner'),
                                               _STATIC)))
    file.write_bytes(parameters)
    values = tally.attempt(lambda: read_parameter_file(file))
    if values is not None:
        tally.attempt(lambda: static_obstacles(values))
        tally.attempt(lambda: settings_of(PlannerParameters, values))
    tally.attempt(lambda: load_robot(file))
    file.write_bytes(_spoilt(random, pick(random, _examples('scenarios'))))
    scenario = tally.attempt(lambda: load_scenario(file))
    if scenario is not None:
        tally.check_finite(scenario.times, scenario.twists, list(scenario.start.values()),
                           scenario.twist_at(0.3 * scenario.duration))
        tally.attempt(scenario.preview)
    for path in (folder, folder / 'missing.yaml', Path('/dev/null'), folder / ('x' * 300)):
        if random.random() < 0.05:
            tally.attempt(lambda path=path: load_robot(path))
            tally.attempt(lambda path=path: load_scenario(path))
    tally.attempt(lambda: _kept(random, folder))


@functools.cache
def _examples(kind: str) -> tuple[str, ...]:
    return tuple(path.read_text()
                 for path in sorted((share_directory() / 'config' / kind).glob('*.yaml')))


def _spoilt(random: np.random.Generator, text: str) -> bytes:
    """Spoil a YAML file as bytes, in its numbers, as a tree, or replace it."""
    chance = random.random()
    if chance < 0.3:
        return spoilt_bytes(random, text.encode())
    if chance < 0.5:
        return spoilt_numbers(random, text).encode()
    if chance < 0.9:
        tree = yaml.safe_load(text)
        for _ in range(int(random.integers(1, 4))):
            tree = spoilt_tree(random, tree)
        return yaml.safe_dump(tree).encode()
    return bytes(pick(random, _TEXTS).encode())


@functools.cache
def _arm() -> Robot:
    return Robot(
        '<robot name="one"><link name="base"/><link name="arm"><collision><origin xyz="0.2 0 0"/>'
        '<geometry><sphere radius="0.1"/></geometry></collision></link>'
        '<joint name="joint" type="revolute"><parent link="base"/><child link="arm"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>',
        'arm', capsules=[])


def _kept(random: np.random.Generator, folder: Path) -> None:
    """Spoil a kept fit: it must be made anew, as it was."""
    fits = fitted_capsules(_arm(), None)
    (file,) = (folder / 'redundant_planner').iterdir()
    content = file.read_bytes()
    kind = random.integers(4)
    if kind == 0:
        file.write_bytes(bytes(pick(random, (b'', b'[]', b'{}', b'null', b'[' * 10**5, b'\xff'))))
    elif kind == 1:
        file.unlink()
        file.mkdir()
    else:
        file.write_bytes(spoilt_bytes(random, content))
    again = fitted_capsules(_arm(), None)
    assert _numbers(again) == _numbers(fits), 'a spoilt fit was believed'
    assert kind == 1 or file.read_bytes() == content, 'a spoilt fit was left'


def _numbers(fits: tuple[Fit, ...]) -> list[object]:
    return [(fit.joint, fit.links, c.name, c.frame, *c.start, *c.end, c.radius)
            for fit in fits for c in fit.capsules]

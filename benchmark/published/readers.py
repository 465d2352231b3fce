"""The published sets: which files of which repository, and what their scenes ask.

Numbers come from the files. What a file leaves to a user's hand or to chance is drawn here, with
the ranges of the file, and the function says so.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import yaml

from benchmark.published.scene import (
    ball,
    calls,
    keyword,
    number,
    numbers,
    PublishedError,
    Scene,
    text_of,
    tree_of,
)
from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles.obstacle import Obstacle

Array = npt.NDArray[np.float64]

_OSCBF = 'StanfordASL/oscbf'
_TABLETOP, _ENVIRONMENT = 'oscbf/examples/cluttered_tabletop.py', 'oscbf/core/manipulation_env.py'
_BODIES = (10, 25, 50)  # 25 unless told otherwise, 50 at most
_PLANNER_BENCH = 'tud-amr/localPlannerBench'
_CASES = 'plannerbenchmark/tests/local_cases'
_NEO = 'petercorke/robotics-toolbox-python'
_PANDAS = ('src/roboticstoolbox/models/URDF/Panda.py', 'roboticstoolbox/models/URDF/Panda.py')
_COLLISION_IK = 'cairo-robotics/collision_ik_ros'
# Where their tips are from the Panda's hand frame [m]: 0.216 m from the last joint's frame, of
# which 0.107 m are the flange; and the Toolbox's gripper.
_OSCBF_TOOL, _NEO_TOOL = 0.109, 0.1034
_READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
# CollisionIK's time goes on by 0.01 / 30 in each of 750 cycles a second.
_SLOWER = 4.0


class PublishedSet(NamedTuple):
    """One set: where it is from, and how it is read."""

    repository: str
    read: Callable[[Path, int], list[Scene]]


def tabletop(folder: Path, count: int) -> list[Scene]:
    """Return OSCBF's tabletop with 10, 25 and 50 spheres, `count` targets each.

    The spheres are those of the file: its seed, NumPy's legacy generator, its two calls of
    `uniform`. The table is a box up to its z_min, below the spheres. In the file a user drags the
    target; here targets are drawn from seed 1, in the spheres' range and up to 0.5 m high, with
    the hand turned as at the start.
    """
    tree = tree_of(folder, _TABLETOP, _OSCBF)
    seed = next(calls(tree, 'random.seed'), None)
    drawn = list(calls(tree, 'random.uniform'))
    low, high = (numbers(_given(drawn[0], key, _TABLETOP)) for key in ('low', 'high')) \
        if len(drawn) == 2 and seed is not None else _fail(_TABLETOP, 'a seed and two uniforms')
    assert seed is not None
    smallest, largest = (number(_given(drawn[1], key, _TABLETOP)) for key in ('low', 'high'))
    most = int(number(_assigned(tree, 'max_num_bodies', _TABLETOP)))
    top = number(_assigned(tree, 'z_min', _TABLETOP))
    random = np.random.RandomState(int(number(seed.args[0])))
    centers = random.uniform(low, high, size=(most, 3))
    sizes = random.uniform(smallest, largest, size=most)
    start = _start_of(tree_of(folder, _ENVIRONMENT, _OSCBF))
    targets = np.random.default_rng(1).uniform(low, [*high[:2], 0.5], size=(count, 3))
    middle = 0.5 * (low + high)
    table = Obstacle.box('table', [middle[0], middle[1], 0.5 * top],
                         (high[0] - low[0], high[1] - low[1], top))
    spheres = [ball(f'sphere{k}', centers[k], float(sizes[k])) for k in range(most)]
    return [Scene(f'{bodies} spheres, target {i}', start, (table, *spheres[:bodies]), target,
                  tool=_OSCBF_TOOL)
            for bodies in _BODIES for i, target in enumerate(targets)]


def _start_of(tree: ast.Module) -> Array:
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and node.name == 'FrankaVelocityControlEnv':
            for part in node.body:
                if isinstance(part, ast.FunctionDef) and part.name == '__init__':
                    names = [a.arg for a in part.args.args][-len(part.args.defaults):]
                    if 'q_init' in names:
                        return numbers(part.args.defaults[names.index('q_init')])
    return _fail(_ENVIRONMENT, "FrankaVelocityControlEnv's q_init")


def planner_bench(folder: Path, count: int) -> list[Scene]:
    """Return localPlannerBench's Panda cases, and `count` more of each from their ranges.

    Only the position counts. The further scenes have goals and spheres from seed 0, uniform in the
    case's ranges, as many as its `randomObstacles`; spheres that move stay as they are. Their
    `child_link` is our tip, and their `r_body` our capsules.
    """
    files = sorted((folder / _CASES).glob('fabric_panda*/setup/exp.yaml'))
    if not files:
        raise PublishedError(f'{folder / _CASES}: no fabric_panda*/setup/exp.yaml; the folder has '
                             f'to be a checkout of https://github.com/{_PLANNER_BENCH}')
    return [scene for file in files for scene in _bench_cases(file, count)]


def _bench_cases(file: Path, count: int) -> Iterator[Scene]:
    name, random = file.parent.parent.name, np.random.default_rng(0)
    try:
        case: dict[str, Any] = yaml.safe_load(file.read_text(encoding='utf-8'))
        goal = case['goal']['subgoal1']
        start = np.array(case['initState']['q0'], dtype=float)
        longest, near = case['T'] * case['dt'], float(goal['epsilon'])
        given = [_bench_ball(key, value) for key, value in case['obstacles'].items()]
        moving = tuple(o for o in given if o.velocity.any())
        number_of, places, radii = _bench_ranges(case)
        yield Scene(name, start, tuple(given), np.array(goal['desired_position'], dtype=float),
                    axes=3, near=near, longest=longest)
        for i in range(count):
            target = random.uniform(goal['low'], goal['high'])
            drawn = [ball(f'random{k}', random.uniform(*places), float(random.uniform(*radii)))
                     for k in range(number_of)]
            yield Scene(f'{name}, random {i}', start,
                        (*moving, *(o for o in drawn if o.half_extents[0] > 1e-3)),
                        target, axes=3, near=near, longest=longest)
    except (KeyError, TypeError, ValueError, yaml.YAMLError, ObstacleError) as error:
        raise PublishedError(f'{file}: no case of localPlannerBench: '
                             f'{type(error).__name__} {str(error).splitlines()[0]}') from None


def _bench_ranges(case: dict[str, Any]) -> tuple[int, Any, Any]:
    """Return how many spheres a random case has, and the ranges of centres and radii."""
    drawn = case['randomObstacles']
    if 'limits' in drawn:
        limits = drawn['limits']
        return (drawn['number'], (limits['x']['low'], limits['x']['high']),
                (limits['r']['low'], limits['r']['high']))
    first = next(iter(case['obstacles'].values()))
    low, high = first['low'], first['high']
    return (drawn['number'], (low['position'], high['position']),
            (low['radius'], high['radius']))


def _bench_ball(name: str, given: dict[str, Any]) -> Obstacle:
    shape = given['geometry']
    if 'trajectory' not in shape:
        return ball(name, np.array(shape['position'], dtype=float), float(shape['radius']))
    lines = [ast.parse(str(line), mode='eval').body for line in shape['trajectory']]
    at = [np.array([number(_Time(t).visit(ast.parse(ast.unparse(line), mode='eval').body))
                    for line in lines]) for t in (0.0, 1.0, 2.0)]
    if not np.allclose(at[2] - at[1], at[1] - at[0]):
        raise ValueError(f'{name} does not move along a line')
    return ball(name, at[0], float(shape['radius']), at[1] - at[0])


class _Time(ast.NodeTransformer):
    """Puts a value in the place of t."""

    def __init__(self, value: float) -> None:
        self._value = value

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return ast.Constant(self._value) if node.id == 't' else node


def neo(folder: Path, count: int) -> list[Scene]:
    """Return NEO's example: two spheres that cross an arm's way to a target.

    The target has the orientation of the start. There is one scene, whatever the count.
    """
    name = 'examples/neo.py'
    tree = tree_of(folder, name, _NEO)
    spheres: dict[str, tuple[Array, float]] = {}
    velocities: dict[str, Array] = {}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Assign):
            continue
        target = ast.unparse(node.targets[0])
        if isinstance(node.value, ast.Call) and ast.unparse(node.value.func).endswith('Sphere'):
            pose = keyword(node.value, 'pose') or keyword(node.value, 'base')
            if isinstance(pose, ast.Call):
                center = np.array([number(argument) for argument in pose.args])
                spheres[target] = center, number(_given(node.value, 'radius', name))
        elif target.endswith('.v'):
            velocities[target[:-2]] = numbers(node.value)[:3]
    if 'target' not in spheres or not velocities:
        _fail(name, 'a target and spheres with velocities')
    file = next((f for f in _PANDAS if (folder / f).is_file()), _PANDAS[0])
    ready = _assigned(tree_of(folder, file, _NEO), 'self.qr', file)
    moving = tuple(ball(key, *spheres[key], velocities[key]) for key in velocities)
    return [Scene('two spheres', numbers(ready)[:7], moving, spheres['target'][0],
                  longest=15.0, tool=_NEO_TOOL)]


def collision_ik(folder: Path, count: int) -> list[Scene]:
    """Return CollisionIK's paths beside its table, its sphere and nothing, `count` at most.

    A path is read as offsets from the tip's first pose, and played at the pace of its node: four
    seconds for one of the file's. A point cloud is taken as the box or the sphere that it is made
    from, by its extent. The arm is a Panda from its ready posture, not their Sawyer. The spheres
    that are moved by an animation of their own are left out.
    """
    table = _extent(folder, 'table')
    sphere = _extent(folder, 'sphere')
    around = {
        'alone': (), 'table': (Obstacle.box('table', table.mean(axis=0), table[1] - table[0]),),
        'sphere': (ball('sphere', sphere.mean(axis=0), float(np.diff(sphere, axis=0).max() / 2)),)}
    names = sorted(file.name for file in (folder / 'animation_files').glob('*')
                   if 'sphere' not in file.name)
    if not names:
        text_of(folder, 'animation_files/rotations', _COLLISION_IK)
    scenes = [Scene(f'{name}, {what}', _READY, obstacles, path=_animation(folder, name))
              for name in names for what, obstacles in around.items()]
    return scenes[:count]


def _extent(folder: Path, name: str) -> Array:
    """Return the least and the greatest corner (2, 3) of a point cloud [m]."""
    file = f'geometry_files/{name}'
    points = _table(text_of(folder, file, _COLLISION_IK).replace(',', ' '), 3, folder / file)
    return np.array((points.min(axis=0), points.max(axis=0)))


def _animation(folder: Path, name: str) -> tuple[Array, Array, Array]:
    file = f'animation_files/{name}'
    text = text_of(folder, file, _COLLISION_IK).replace(';', ' ').replace(',', ' ')
    rows = _table(text, 8, folder / file)
    turns = np.array([pin.Quaternion(w, x, y, z).normalized().matrix()
                      for w, x, y, z in rows[:, 4:]])
    return rows[:, 1:4], turns, _SLOWER * rows[:, 0]


def _table(text: str, columns: int, file: Path) -> Array:
    try:
        rows = np.array([[float(word) for word in line.split()]
                         for line in text.splitlines() if line.strip()])
    except ValueError:
        rows = np.empty(0)
    if rows.ndim != 2 or rows.shape[1] != columns or not np.isfinite(rows).all():
        raise PublishedError(f'{file}: every line has to have {columns} numbers')
    return rows


def _given(call: ast.Call, name: str, file: str) -> ast.expr:
    value = keyword(call, name)
    return _fail(file, f'{name}=') if value is None else value


def _assigned(tree: ast.Module, name: str, file: str) -> ast.expr:
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return node.value
    return _fail(file, f'{name} = …')


def _fail(file: str, what: str) -> Any:
    raise PublishedError(f'{file}: {what} is missing; the file is not as it was published')


SETS = {
    'oscbf': PublishedSet(_OSCBF, tabletop),
    'planner_bench': PublishedSet(_PLANNER_BENCH, planner_bench),
    'neo': PublishedSet(_NEO, neo),
    'collision_ik': PublishedSet(_COLLISION_IK, collision_ik),
}

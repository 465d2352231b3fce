"""Problems of MotionBenchMaker: a MoveIt scene and a request each, as YAML.

A folder holds one folder for each family, and these pairs of files: scene0001.yaml with the
obstacles (`world: collision_objects`), request0001.yaml with `start_state` and
`goal_constraints`. KavrakiLab/vamp has them as resources/panda/problems.tar.bz2.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import re
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import yaml

from benchmark.problem_sets.problem import Problem
from redundant_planner.core.errors import known, ObstacleError
from redundant_planner.core.obstacles.obstacle import Obstacle

Array = npt.NDArray[np.float64]

# Types of shape_msgs/SolidPrimitive, by name and number, and how many dimensions they take.
_TYPES: dict[Any, str] = {1: 'box', 2: 'sphere', 3: 'cylinder'}
_DIMENSIONS = {'box': ('length, width and height', 3), 'sphere': ('radius', 1),
               'cylinder': ('height and radius', 2)}
# Whatever else may stand in a collision object, but not here.
_OTHER_SHAPES = ('meshes', 'planes')
_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


class ProblemFileError(ValueError):
    """A file does not hold what it should: the message says which, what, and what would do."""


def find_files(folder: Path, families: Sequence[str] = ()) -> list[tuple[str, Path, Path]]:
    """Return family, scene and request of every problem below a folder.

    Args:
        folder: that holds folders, one for each family.
        families: names of the families to take; all if there are none.

    Raises:
        ProblemFileError: there are no problems, no such family, or a scene has no request.
    """
    if not folder.is_dir():
        raise ProblemFileError(f'{folder}: there is no such folder; unpack the problems there')
    found: dict[str, list[tuple[str, Path, Path]]] = {}
    for scene in sorted(folder.rglob('scene*.yaml')):
        family = scene.parent.name.removesuffix('_panda')
        request = scene.with_name(scene.name.replace('scene', 'request', 1))
        if not request.is_file():
            raise ProblemFileError(f'{scene}: its request is missing; it would be {request.name} '
                                   'in the same folder')
        found.setdefault(family, []).append((family, scene, request))
    if not found:
        raise ProblemFileError(
            f'{folder}: there are no problems; files are to be called scene0001.yaml and '
            'request0001.yaml, in a folder for each family')
    wanted = [name.removesuffix('_panda') for name in families] or list(found)
    for name in wanted:
        if name not in found:
            raise ProblemFileError(
                f"{folder}: there is no family '{name}'; there are {known(found)}")
    return [files for name in wanted for files in found[name]]


def read_problem(
    family: str, scene: Path, request: Path, joint_names: Sequence[str],
) -> Problem:
    """Return the problem that two files describe.

    Args:
        family: its name.
        scene, request: the files.
        joint_names: of the arm.

    Raises:
        ProblemFileError: with the file, what is wrong and what would be right.
    """
    number = ''.join(re.findall(r'\d+', scene.stem)) or scene.stem
    start, goal = _postures(_File(request), joint_names)
    return Problem(f'{family}/{number}', family, tuple(_obstacles(_File(scene))), start, goal)


class _File:
    """A YAML file and what is asked of it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.content = yaml.load(path.read_text(), _LOADER)
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise self.error(f'cannot be read as YAML ({" ".join(str(error).split())})',
                             'a MoveIt planning scene or request') from None

    def error(self, what: str, right: str) -> ProblemFileError:
        """Return an error about this file."""
        return ProblemFileError(f'{self.path}: {what}; it takes {right}')

    def entry(self, holder: Any, where: str, key: str, kind: type, right: str) -> Any:
        """Return an entry of a mapping, which has to be of some kind."""
        value = holder.get(key) if isinstance(holder, dict) else None
        if not isinstance(value, kind):
            place = f'{where}.{key}' if where else key
            raise self.error(f'{place} is {_shown(value)}', right)
        return value

    def numbers(self, given: Any, where: str, count: int, keys: str, right: str) -> Array:
        """Return finite numbers from a list, or from a mapping with one key for each."""
        if isinstance(given, dict):
            given = [given.get(key) for key in keys]
        try:
            # YAML takes 1e-05 for text.
            values = np.array([float(value) for value in given])
        except (TypeError, ValueError):
            values = np.empty(0)
        if values.shape != (count,) or not np.isfinite(values).all():
            raise self.error(f'{where} is {_shown(given)}', right)
        return values


def _shown(value: Any) -> str:
    text = 'missing' if value is None else repr(value)
    return text if len(text) < 60 else text[:57] + '...'


def _postures(file: _File, joint_names: Sequence[str]) -> tuple[Array, Array]:
    """Return the start and the goal."""
    state = file.entry(file.content, '', 'start_state', dict, 'joint_state with name and position')
    joints = file.entry(state, 'start_state', 'joint_state', dict, 'name and position')
    where, right = 'start_state.joint_state', 'as many names as positions'
    names = file.entry(joints, where, 'name', list, right)
    positions = file.entry(joints, where, 'position', list, right)
    if len(names) != len(positions):
        raise file.error(f'{where} has {len(names)} names and {len(positions)} positions', right)
    start = dict(zip(names, positions))
    right = 'one with joint_constraints: a joint_name and position for every joint'
    goals = file.entry(file.content, '', 'goal_constraints', list, right)
    where = 'goal_constraints[0]'
    constraints = file.entry(goals[0] if goals else None, where, 'joint_constraints', list, right)
    goal = {one.get('joint_name'): one.get('position') for one in constraints
            if isinstance(one, dict)}
    found = []
    for what, values in (('start_state', start), (f'{where}.joint_constraints', goal)):
        missing = [name for name in joint_names if name not in values]
        if missing:
            raise file.error(f'{what} lacks {known(missing)}', f'all of {known(joint_names)}')
        found.append(file.numbers(
            [values[name] for name in joint_names], what, len(joint_names), '',
            'a finite position for every joint [rad]'))
    return found[0], found[1]


def _obstacles(file: _File) -> list[Obstacle]:
    """Return the obstacles of a scene, one for each primitive."""
    world = file.entry(file.content, '', 'world', dict, 'collision_objects')
    objects = file.entry(world, 'world', 'collision_objects', list, 'a list of objects')
    _check_base(file)
    found = []
    for i, item in enumerate(objects):
        where = f'world.collision_objects[{i}]'
        name = str(file.entry(item, where, 'id', str, 'a name'))
        right = 'a list of boxes, spheres and cylinders, and one of their poses'
        for other in _OTHER_SHAPES:
            if item.get(other):
                raise file.error(f"object '{name}' has {other}", right)
        shapes = file.entry(item, where, 'primitives', list, right)
        poses = file.entry(item, where, 'primitive_poses', list, right)
        if len(shapes) != len(poses):
            raise file.error(f"object '{name}' has {len(shapes)} primitives and {len(poses)} "
                             'primitive_poses', 'as many of these as of those')
        place = (_pose(file, item['pose'], f'{where}.pose') if 'pose' in item
                 else pin.SE3.Identity())
        for k, (shape, pose) in enumerate(zip(shapes, poses)):
            at = place * _pose(file, pose, f'{where}.primitive_poses[{k}]')
            found.append(_primitive(
                file, shape, f'{where}.primitives[{k}]', f'{name}/{k}' if k else name, at))
    return found


def _check_base(file: _File) -> None:
    """Refuse a scene in another frame than the arm's base: nothing would be where it should."""
    for i, item in enumerate(file.content.get('fixed_frame_transforms') or []):
        where = f'fixed_frame_transforms[{i}].transform'
        moved = item.get('transform', {}) if isinstance(item, dict) else {}
        at = _pose(file, {'position': moved.get('translation', (0, 0, 0)),
                          'orientation': moved.get('rotation', (0, 0, 0, 1))}, where)
        if not at.isIdentity(1e-9):
            raise file.error(f'{where} moves or turns the frame of the scene',
                             "obstacles in the frame of the arm's base, and no transform")


def _pose(file: _File, given: Any, where: str) -> pin.SE3:
    """Return a pose of a position and a quaternion, which is normalised."""
    right = 'a position [x, y, z] and an orientation [x, y, z, w] that is not zero'
    if not isinstance(given, dict):
        raise file.error(f'{where} is {_shown(given)}', right)
    position = file.numbers(given.get('position'), f'{where}.position', 3, 'xyz', right)
    quaternion = file.numbers(given.get('orientation'), f'{where}.orientation', 4, 'xyzw', right)
    size = float(np.linalg.norm(quaternion))
    if size < 1e-6:
        raise file.error(f'{where}.orientation is {quaternion.tolist()}', right)
    return pin.SE3(pin.Quaternion(quaternion / size), position)


def _primitive(file: _File, given: Any, where: str, name: str, at: pin.SE3) -> Obstacle:
    """Return a box, a sphere or a cylinder."""
    if not isinstance(given, dict):
        raise file.error(f'{where} is {_shown(given)}', 'a type and dimensions')
    kind = _TYPES.get(given.get('type'), given.get('type'))
    if kind not in _DIMENSIONS:
        raise file.error(f'{where}.type is {_shown(given.get("type"))}', known(_DIMENSIONS))
    what, count = _DIMENSIONS[kind]
    sizes = file.numbers(given.get('dimensions'), f'{where}.dimensions', count, '',
                         f'{what}, of a {kind} [m]')
    orientation = pin.Quaternion(at.rotation).coeffs()
    try:
        if kind == 'box':
            return Obstacle.box(name, at.translation, sizes, orientation=orientation)
        if kind == 'cylinder':
            return Obstacle.cylinder(
                name, at.translation, sizes[1], sizes[0], orientation=orientation)
        return Obstacle(name, at.translation, np.full(3, sizes[0]), orientation)
    except ObstacleError as error:
        raise file.error(f'{where}: {error}', f'a positive {what} [m]') from None

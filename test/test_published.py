"""Published scenes are read from folders in their formats, and judged."""

from __future__ import annotations

import json
from pathlib import Path
import sys

import numpy as np
import pytest

pytest.importorskip('coal')
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmark.published.__main__ import main
from benchmark.published.readers import SETS
from benchmark.published.run import METHODS, poses_of, Runner
from benchmark.published.scene import PublishedError, Scene
from benchmark.robots import make_robot
from redundant_planner.io.resources import panda_urdf

needs_panda = pytest.mark.skipif(panda_urdf() is None, reason='no Panda URDF')

TABLETOP = """
import numpy as np
np.random.seed(3)
def main():
    z_min = 0.1
    max_num_bodies = 50
    all_collision_pos = np.random.uniform(
        low=[0.2, -0.4, 0.1], high=[0.8, 0.4, 0.3], size=(max_num_bodies, 3))
    all_collision_radii = np.random.uniform(low=0.01, high=0.1, size=(max_num_bodies,))
"""
ENVIRONMENT = """
class FrankaVelocityControlEnv:
    def __init__(self, a=None, q_init=(0, -np.pi / 3, 0, -5 * np.pi / 6, 0, np.pi / 2, 0)):
        pass
"""
NEO = """
s0 = sg.Sphere(radius=0.05, pose=sm.SE3(0.52, 0.4, 0.3))
s0.v = [0, -0.2, 0, 0, 0, 0]
target = sg.Sphere(radius=0.02, pose=sm.SE3(0.6, -0.2, 0.1))
"""
PANDA = 'class Panda:\n    def __init__(self):\n' \
        '        self.qr = np.array([0, -0.3, 0, -2.2, 0, 2.0, np.pi / 4])\n'
CASE = """
T: 2000
dt: 0.01
goal: {subgoal1: {desired_position: [0.5, -0.4, 0.3], low: [-0.4, -0.4, 0.1],
                  high: [0.7, 0.0, 1.1], epsilon: 0.05}}
initState: {q0: [1.0, 0.0, 0.0, -1.5, 0.0, 1.8675, 0.0]}
obstacles:
  still: {geometry: {position: [0.7, 0.3, 0.6], radius: 0.15},
          low: {position: [-1.0, -1.0, 0.0], radius: 0.0},
          high: {position: [1.0, 0.3, 1.0], radius: 0.2}}
  moving: {geometry: {trajectory: ["-1.0 + 0.1 * t", "-0.4", "0.7"], radius: 0.1}}
randomObstacles: {number: 5}
"""


def write(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def folders(tmp_path):
    circle = [(0.01 * i, 0.05 * np.sin(0.06 * i)) for i in range(101)]
    return {
        'oscbf': write(tmp_path / 'oscbf', {
            'oscbf/examples/cluttered_tabletop.py': TABLETOP,
            'oscbf/core/manipulation_env.py': ENVIRONMENT}),
        'neo': write(tmp_path / 'neo', {
            'examples/neo.py': NEO, 'src/roboticstoolbox/models/URDF/Panda.py': PANDA}),
        'planner_bench': write(tmp_path / 'bench', {
            'plannerbenchmark/tests/local_cases/fabric_panda_x/setup/exp.yaml': CASE}),
        'collision_ik': write(tmp_path / 'ik', {
            'geometry_files/table': '0.9,-0.3,0.1\n1.0,0.1,0.2\n',
            'geometry_files/sphere': '0.2 0.5 0.5\n0.4 0.7 0.7\n',
            'animation_files/way': ''.join(
                f'{t};{y},0.0,0.0;1.0,0.0,0.0,0.0\n' for t, y in circle),
            'animation_files/way_sphere1': ''})}


def test_the_spheres_of_the_tabletop_are_those_of_its_seed(folders):
    scenes = SETS['oscbf'].read(folders['oscbf'], 2)
    random = np.random.RandomState(3)
    centers = random.uniform([0.2, -0.4, 0.1], [0.8, 0.4, 0.3], size=(50, 3))
    radii = random.uniform(0.01, 0.1, size=50)
    assert [len(scene.obstacles) - 1 for scene in scenes] == [10, 10, 25, 25, 50, 50]
    for k, sphere in enumerate(scenes[-1].obstacles[1:]):
        np.testing.assert_array_equal(sphere.center, centers[k])
        np.testing.assert_allclose(sphere.half_extents, radii[k])
    np.testing.assert_allclose(scenes[0].start[:4], [0, -np.pi / 3, 0, -5 * np.pi / 6])


def test_numbers_of_neo_and_the_planner_bench_are_those_of_the_files(folders):
    scene, = SETS['neo'].read(folders['neo'], 1)
    np.testing.assert_allclose(scene.goal, [0.6, -0.2, 0.1])
    np.testing.assert_allclose(scene.at(2.0)[0].center, [0.52, 0.0, 0.3])
    np.testing.assert_allclose(scene.start[-1], np.pi / 4)
    first, *drawn = SETS['planner_bench'].read(folders['planner_bench'], 3)
    np.testing.assert_allclose(first.obstacles[1].velocity, [0.1, 0.0, 0.0])
    assert first.axes == 3 and first.near == 0.05 and first.longest == pytest.approx(20.0)
    assert len(drawn) == 3
    for scene in drawn:
        assert (scene.goal >= [-0.4, -0.4, 0.1]).all() and (scene.goal <= [0.7, 0.0, 1.1]).all()
        assert scene.obstacles[0].velocity.any() and len(scene.obstacles) <= 6


@needs_panda
def test_a_path_is_played_four_times_slower_from_the_tips_first_pose(folders):
    scenes = SETS['collision_ik'].read(folders['collision_ik'], 3)
    assert [scene.name for scene in scenes] == ['way, alone', 'way, table', 'way, sphere']
    robot = make_robot('panda', 6)
    poses, first = poses_of(robot, scenes[0]), robot.kinematics(scenes[0].start)
    assert len(poses) == 1001
    for i in (0, 400, 1000):
        np.testing.assert_allclose(
            poses[i].position - first.tip_position,
            [0.05 * np.sin(0.06 * i / 10), 0.0, 0.0], atol=1e-6)
        np.testing.assert_allclose(poses[i].rotation, first.tip_rotation, atol=1e-9)


@pytest.mark.parametrize('name', list(SETS))
def test_a_folder_without_the_files_gets_a_line_that_says_where_to_get_them(
        name, tmp_path, capsys):
    assert main([name, str(tmp_path)]) == 2
    said = capsys.readouterr().out.strip().splitlines()
    assert len(said) == 1
    assert str(tmp_path) in said[0] and SETS[name].repository in said[0]


@pytest.mark.parametrize('name, file, text', [
    ('oscbf', 'oscbf/examples/cluttered_tabletop.py', 'x = 1\n'),
    ('oscbf', 'oscbf/core/manipulation_env.py', 'def ('),
    ('neo', 'examples/neo.py', 'target = 3\n'),
    ('planner_bench', 'plannerbenchmark/tests/local_cases/fabric_panda_x/setup/exp.yaml', 'T: 1'),
    ('collision_ik', 'animation_files/way', '0.0;1.0\n')])
def test_broken_files_are_refused(folders, name, file, text):
    (folders[name] / file).write_text(text)
    with pytest.raises(PublishedError, match=Path(file).name):
        SETS[name].read(folders[name], 1)


@pytest.mark.long
@needs_panda
def test_a_run_says_what_it_came_to(folders, tmp_path):
    file = tmp_path / 'out.json'
    assert main(['neo', str(folders['neo']), '--method', 'dynamic_factor',
                 '--json', str(file)]) == 0
    entry = json.loads(file.read_text())['dynamic_factor']
    assert entry['count'] == 1 and entry['reached'] == 1
    assert entry['collisions'] == entry['self_collisions'] == entry['limit_violations'] == 0
    assert entry['min_distance_mm'] > 0.0 and entry['path_median'] > 0.1


@needs_panda
def test_the_judge_sees_collisions_and_paths_that_were_left():
    start = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, np.pi / 4])
    times = np.linspace(0.0, 1.0, 51)
    line = np.outer(times, [0.1, 0.0, 0.0])
    path = line, np.tile(np.eye(3), (51, 1, 1)), times
    outcome = Runner(0.01).run(Scene('line', start, (), path=path), next(iter(METHODS)))
    # From rest the arm cannot be at 0.1 m/s at once, so it ends a little behind, on the line.
    assert outcome.path_error < 1e-3 and outcome.limit_violation == 0.0
    assert outcome.obstacle == np.inf

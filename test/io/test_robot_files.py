"""The robot files of config/ describe the arms they name."""

from __future__ import annotations

from conftest import EXAMPLE_ROBOTS, make_panda, PANDA_URDF, ROBOTS
import numpy as np
import pinocchio as pin

from redundant_planner.analysis.metrics import smallest_clearance
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.io.robot_files import load_robot
from redundant_planner.simulation import simulate


def distance_to_segment(points, start, end):
    along = end - start
    t = np.clip((points - start) @ along / max(along @ along, 1e-12), 0.0, 1.0)
    return np.linalg.norm(points - start - t[:, None] * along, axis=1)


def test_every_vertex_of_the_pandas_meshes_is_inside_a_capsule():
    model = pin.buildModelFromUrdf(str(PANDA_URDF))
    geometry = pin.buildGeomFromUrdf(model, str(PANDA_URDF), pin.GeometryType.COLLISION,
                                     package_dirs=[str(EXAMPLE_ROBOTS.parent.parent)])
    capsules = {}
    for capsule in make_panda().capsules:
        capsules.setdefault(capsule.frame, []).append(capsule)
    checked = 0
    for shape in geometry.geometryObjects:
        frame = model.frames[shape.parentFrame]
        if frame.name == 'panda_link0' or not hasattr(shape.geometry, 'vertices'):
            continue
        vertices = np.array(shape.geometry.vertices()) * np.array(shape.meshScale)
        to_link = frame.placement.inverse() * shape.placement
        vertices = vertices @ to_link.rotation.T + to_link.translation
        depth = np.min([distance_to_segment(vertices, c.start, c.end) - c.radius
                        for c in capsules[frame.name]], axis=0)
        assert depth.max() <= 0.0, f'{frame.name}: {1e3 * depth.max():.2f} mm outside'
        checked += 1
    assert checked >= 8


def test_the_xarm_plans_with_its_capsules_fitted(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    urdf = EXAMPLE_ROBOTS / 'xarm_description' / 'urdf' / 'xarm7.urdf'
    robot = load_robot(ROBOTS / 'xarm7.yaml', urdf=str(urdf))
    assert robot.n == 7 and len(robot.capsules) == 7
    start = np.array([0.0, -0.5, 0.0, 0.9, 0.0, 1.4, 0.0])
    ball = Obstacle('ball', np.array([0.25, 0.12, 0.45]), np.full(3, 0.04))
    twist = np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    motion = simulate(Planner(robot, PlannerParameters()), start, lambda t: twist,
                      Scene.of([ball]), 1.0, 0.004)
    assert smallest_clearance(robot, motion.positions, [ball]).level > 0.0
    assert np.linalg.norm(motion.results[-1].path_error[:3]) < 1e-3
    assert motion.results[-1].nearest.obstacle == 'ball'

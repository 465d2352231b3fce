"""The robot files of config/ describe the arms they name."""

from __future__ import annotations

from conftest import EXAMPLE_ROBOTS, make_panda, PANDA_URDF, ROBOTS
import numpy as np
import pinocchio as pin
import pytest

from redundant_planner.analysis.metrics import smallest_clearance
from redundant_planner.core.errors import ParameterError, RobotError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.io.parameter_files import read_robot_parameters
from redundant_planner.io.robot_files import load_robot, with_more_capsules
from redundant_planner.simulation import simulate


def distance_to_segment(points, start, end):
    along = end - start
    t = np.clip((points - start) @ along / max(along @ along, 1e-12), 0.0, 1.0)
    return np.linalg.norm(points - start - t[:, None] * along, axis=1)


def panda_vertices():
    """The link and the vertices (k, 3) in its frame of every collision mesh."""
    model = pin.buildModelFromUrdf(str(PANDA_URDF))
    geometry = pin.buildGeomFromUrdf(model, str(PANDA_URDF), pin.GeometryType.COLLISION,
                                     package_dirs=[str(EXAMPLE_ROBOTS.parent.parent)])
    for shape in geometry.geometryObjects:
        if hasattr(shape.geometry, 'vertices'):
            frame = model.frames[shape.parentFrame]
            vertices = np.array(shape.geometry.vertices()) * np.array(shape.meshScale)
            to_link = frame.placement.inverse() * shape.placement
            yield frame.name, vertices @ to_link.rotation.T + to_link.translation


def test_every_vertex_of_the_pandas_meshes_is_inside_a_capsule():
    capsules = {}
    for capsule in make_panda().capsules:
        capsules.setdefault(capsule.frame, []).append(capsule)
    checked = 0
    for link, vertices in panda_vertices():
        depth = np.min([distance_to_segment(vertices, c.start, c.end) - c.radius
                        for c in capsules[link]], axis=0)
        assert depth.max() <= 0.0, f'{link}: {1e3 * depth.max():.2f} mm outside'
        checked += 1
    assert checked >= 9


def robot_parameters():
    return read_robot_parameters(ROBOTS / 'panda.yaml')[0]


def test_more_capsules_may_be_on_links_that_stand_still_and_change_nothing_else():
    panda, entry = make_panda(), {'frame': 'panda_link0', 'start': [0.0, 0.0, 0.05],
                                  'end': [0.1, 0.0, 0.05], 'radius': 0.1}
    assert with_more_capsules(panda, robot_parameters(), {}) is panda
    more = with_more_capsules(panda, robot_parameters(), {'base': entry})
    arm, same = more.kinematics(np.ones(7)), panda.kinematics(np.ones(7))
    np.testing.assert_array_equal(arm.segment_end[:-1], same.segment_end)
    np.testing.assert_allclose(arm.segment_end[-1], [0.1, 0.0, 0.05])
    assert not more.lever_arm_bounds[-1].any()
    np.testing.assert_array_equal(more.lever_arm_bounds[:-1], panda.lever_arm_bounds)
    with pytest.raises(ParameterError, match="capsule 'base' lacks 'radius'"):
        with_more_capsules(panda, robot_parameters(), {'base': {
            key: entry[key] for key in ('frame', 'start', 'end')}})
    with pytest.raises(RobotError, match="no frame 'moon'"):
        with_more_capsules(panda, robot_parameters(), {'base': {**entry, 'frame': 'moon'}})


def test_the_xarm_plans_with_its_capsules_fitted(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    urdf = EXAMPLE_ROBOTS / 'xarm_description' / 'urdf' / 'xarm7.urdf'
    robot = load_robot(ROBOTS / 'xarm7.yaml', urdf=str(urdf))
    assert robot.n == 7 and len(robot.capsules) == 8
    start = np.array([0.0, -0.5, 0.0, 0.9, 0.0, 1.4, 0.0])
    ball = Obstacle('ball', np.array([0.25, 0.12, 0.45]), np.full(3, 0.04))
    twist = np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    motion = simulate(Planner(robot, PlannerParameters()), start, lambda t: twist,
                      Scene.of([ball]), 1.0, 0.004)
    assert smallest_clearance(robot, motion.positions, [ball]).level > 0.0
    assert np.linalg.norm(motion.results[-1].path_error[:3]) < 1e-3
    assert motion.results[-1].nearest.obstacle == 'ball'

"""The optimum knows all shapes, and goals without a path (runs where CasADi is installed)."""

from __future__ import annotations

from pathlib import Path
import sys

from conftest import make_panda, PANDA_READY, random_postures
import numpy as np
import pytest

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
casadi = pytest.importorskip('casadi')
from benchmark.bodies import capsules_of  # noqa: E402
from benchmark.free_way import FreeWay  # noqa: E402
from benchmark.optimum import Optimum  # noqa: E402
from benchmark.problem_sets.problem import tip_pose  # noqa: E402
from benchmark.symbolic_clearance import clearance  # noqa: E402

_TURN = np.array([0.3, -0.2, 0.5, 0.8]) / np.linalg.norm([0.3, -0.2, 0.5, 0.8])
_PLACE = (0.35, 0.2, 0.5)


@pytest.mark.parametrize('obstacle', [
    Obstacle.box('box', _PLACE, (0.2, 0.1, 0.3), orientation=_TURN),
    Obstacle.cylinder('cylinder', _PLACE, 0.08, 0.3, orientation=_TURN),
    Obstacle.capsule('capsule', _PLACE, 0.06, 0.3, orientation=_TURN),
], ids=lambda o: o.shape)
def test_its_clearance_is_the_planners_but_for_the_points_in_between(obstacle):
    robot = make_panda()
    start, end = casadi.SX.sym('start', 3), casadi.SX.sym('end', 3)
    maps = inflated_obstacles(Scene.of([obstacle]), [c.radius for c in robot.capsules])
    functions = [casadi.Function('c', [start, end], [clearance(
        obstacle, start, end, float(np.linalg.norm(c.end - c.start)), c.radius)])
        for c in robot.capsules]
    for q in random_postures(robot, 10):
        arm = robot.kinematics(q)
        exact = link_clearance(maps, arm.segment_start, arm.segment_end).distance[:, 0]
        for i, function in enumerate(functions):
            found = 0.1 * float(function(arm.segment_start[i], arm.segment_end[i]))
            # No point of a link is further than 25 mm from one that is looked at.
            assert exact[i] - 1e-6 < found < exact[i] + 0.025


def test_a_goal_without_a_path_is_reached_around_a_wall():
    robot = make_panda()
    start, goal = PANDA_READY.copy(), PANDA_READY.copy()
    start[0], goal[0] = -0.8, 0.8
    middle = tip_pose(robot, PANDA_READY).position
    wall = Obstacle.box('wall', [middle[0] + 0.05, 0.0, 0.35], (0.2, 0.04, 0.7))
    way = FreeWay(robot, capsules_of(robot), (wall,), 0.01).find(start, goal)
    poses = [*[None] * 80, tip_pose(robot, goal)]
    cost, nodes = Optimum(robot, start, poses, 0.05, [wall], 0.01).best([way])
    np.testing.assert_allclose(
        robot.kinematics(nodes[-1]).tip_position, poses[-1].position, atol=1e-6)
    shortened = np.abs(np.diff(nodes, axis=0)).sum()
    assert cost > 0.0 and shortened < np.abs(np.diff(way, axis=0)).sum()
    maps = inflated_obstacles(Scene.of([wall]), [c.radius for c in robot.capsules])
    for q in nodes[1:]:
        arm = robot.kinematics(q)
        assert link_clearance(
            maps, arm.segment_start, arm.segment_end).distance.min() > 0.0

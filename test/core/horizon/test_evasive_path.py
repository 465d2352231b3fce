"""The joint path that leaves the commanded path least: what a step minimises."""

from __future__ import annotations

from closed_loop import mixed_scene
from conftest import central_difference, make_panda, make_paper_arm, PANDA_READY, random_postures
import numpy as np
import pytest

from redundant_planner.core.constants import limits_of
from redundant_planner.core.horizon.evasive_path import Demand, Due, improved
from redundant_planner.core.horizon.poses_ahead import poses_ahead
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import AXES, PlannerParameters
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose

STEP, NODES = 0.16, 4
DEMAND = Demand(1000.0, 0.005)


class Problem:
    """A problem and its price, written down once more."""

    def __init__(self, robot, q, previous, twist, obstacles, weights=None):
        self.robot, self.q, self.previous = robot, q, previous
        self.scaling = 1.0 / np.sqrt(np.ones(robot.n) if weights is None else weights)
        self.limits = limits_of(robot, PlannerParameters())
        self.obstacles = inflated_obstacles(
            Scene.of(obstacles), [c.radius for c in robot.capsules])
        arm, self.times = robot.kinematics(q), STEP * np.arange(NODES + 1.0)
        along = robot.task_rows(twist)
        speed = np.linalg.norm(along)
        self.due = Due(
            poses_ahead(arm.tips, np.tile(twist, (NODES, 1)),
                        self.times, robot.in_tool),
            along / max(speed, 1e-12), speed * self.times[1:])

    def step(self, nodes, demand=DEMAND):
        return improved(self.q, self.previous, nodes, self.due, self.obstacles, self.robot.chain,
                        self.limits, self.scaling, STEP, demand)

    def settled(self, nodes, steps=60):
        for _ in range(steps):
            nodes = self.step(nodes).nodes
        return nodes

    def errors(self, nodes):
        """The errors (N, m), of which how far the tip is behind counts a tenth."""
        found = []
        for i, q in enumerate(nodes):
            arm = self.robot.kinematics(q)
            error = se3.pose_error(
                Pose(self.due.poses.position[i], self.due.poses.rotation[i]),
                Pose(arm.tip_position, arm.tip_rotation), self.robot.in_tool)[self.robot.rows]
            lag = error @ self.due.along
            behind = min(max(lag, 0.0), self.due.behind[i])
            found.append(error - 0.9 * behind * self.due.along)
        return np.array(found)

    def price(self, nodes):
        """The sum that the module's first lines name."""
        rates = np.diff(np.vstack((self.q, nodes)), axis=0) / STEP
        changes = np.diff(np.vstack((self.previous, rates)), axis=0) / STEP
        high, low = self.limits.positions
        most = np.full((NODES, 1), 0.8) * self.limits.acceleration_max
        most[0] *= 0.5
        excess = (100.0 * beyond(nodes, low, high).sum()
                  + beyond(rates, -0.9 * self.limits.velocity_max,
                           0.9 * self.limits.velocity_max).sum()
                  + STEP ** 2 * beyond(changes, -most, most).sum())
        arms = self.robot.kinematics_along(nodes)
        pairs = link_clearance(
            self.obstacles, arms.segment_start, arms.segment_end, self.times[1:])
        short = np.square(np.minimum(pairs.distance - DEMAND.reserve, 0.0)).sum()
        weights = self.scaling ** -2
        return excess + STEP * (
            np.square(self.errors(nodes)).sum() + 1e-3 * (weights * rates ** 2).sum()
            + 1e-5 * (weights * changes ** 2).sum() + DEMAND.price * short)


def beyond(values, low, high):
    return np.square(values - np.clip(values, low, high))


def problems(make, count):
    robot = make()
    random = np.random.default_rng(5)
    for seed, q in enumerate(random_postures(robot, count)):
        twist = robot.full_twist(robot.task_rows(0.2 * random.normal(size=6)))
        yield random, Problem(
            robot, q, 0.3 * random.normal(size=robot.n), twist * (seed % 3 > 0),
            mixed_scene(seed, 2), random.uniform(0.5, 4.0, robot.n))


@pytest.mark.parametrize('make', [make_panda, lambda: make_panda(axes=AXES[:3]),
                                  lambda: make_panda(command_frame='tool'), make_paper_arm])
def test_a_step_reports_the_price_of_the_nodes_before_it(make):
    for random, problem in problems(make, 20):
        nodes = problem.q + 0.3 * random.normal(size=(NODES, problem.robot.n))
        found = problem.step(nodes)
        assert found.price == pytest.approx(problem.price(nodes), rel=1e-9)
        assert found.deviation == pytest.approx(
            np.linalg.norm(problem.errors(nodes), axis=1).max(), rel=1e-9)
        arms = problem.robot.kinematics_along(nodes)
        distances = link_clearance(problem.obstacles, arms.segment_start, arms.segment_end,
                                   problem.times[1:]).distance
        if found.nearest < 0.1:  # further away, a bound is enough
            _, link, obstacle = np.unravel_index(distances.argmin(), distances.shape)
            assert found.nearest == pytest.approx(distances.min(), abs=1e-9)
            assert (found.nearest_link, found.nearest_obstacle) == (link, obstacle)


@pytest.mark.parametrize('make', [make_panda, lambda: make_panda(axes=AXES[:3]),
                                  make_paper_arm])
def test_steps_come_to_rest_where_the_price_has_no_slope(make):
    rested, begins = 0, []
    for _, problem in problems(make, 12):
        nodes = problem.settled(np.tile(problem.q, (NODES, 1)))
        if np.abs(problem.step(nodes).nodes - nodes).max() > 1e-9:
            continue  # between two sides of an edge
        rested += 1

        def price(flat, problem=problem):
            return problem.price(flat.reshape(NODES, -1))

        slope = central_difference(price, nodes.ravel())
        begins.append(np.abs(central_difference(price, np.tile(problem.q, NODES))).max())
        # A rotation's error turns with it: that is left out.
        assert np.abs(slope).max() < 1e-4
    assert rested >= 7 and max(begins) > 1e-2


def test_without_anything_near_the_tip_follows_its_command():
    robot = make_panda()
    twist = np.array([0.05, 0.0, 0.05, 0.0, 0.0, 0.1])
    problem = Problem(robot, np.array(PANDA_READY), np.zeros(robot.n), twist, ())
    nodes = problem.settled(np.tile(problem.q, (NODES, 1)), 10)
    found = problem.step(nodes)
    assert found.deviation < 1e-2 and not found.threatened
    assert (found.nearest, found.nearest_link) == (np.inf, -1)


def test_a_ball_bends_the_path_before_it_gets_there():
    """The ball comes from the side and is at the elbow at the last node."""
    robot = make_panda()
    q = np.array(PANDA_READY)
    arm = robot.kinematics(q)
    elbow = [c.name for c in robot.capsules].index('link4')
    middle = 0.5 * (arm.segment_start[elbow] + arm.segment_end[elbow])
    velocity = np.array([0.0, -0.3, 0.0])
    ball = Obstacle('ball', middle + [0.0, 0.0, 0.08] - NODES * STEP * velocity, [0.04] * 3,
                    velocity=velocity)
    problem = Problem(robot, q, np.zeros(robot.n), np.zeros(6), [ball])
    nodes = problem.settled(np.tile(q, (NODES, 1)))
    found = problem.step(nodes)
    assert found.threatened and found.nearest > 0.0
    still = Problem(robot, q, np.zeros(robot.n), np.zeros(6), [ball.after(NODES * STEP)])
    away = still.obstacles  # as near as it comes
    apart = [link_clearance(away, *(e[None] for e in (a.segment_start, a.segment_end)),
                            np.zeros(1)).distance.min()
             for a in (robot.kinematics(q), robot.kinematics(nodes[-1]))]
    assert apart[0] < -0.01 and apart[1] > 0.0

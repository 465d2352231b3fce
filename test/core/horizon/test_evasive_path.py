"""The joint path that leaves the commanded path least: what a step minimises."""

from __future__ import annotations

from closed_loop import mixed_scene
from conftest import central_difference, make_panda, make_paper_arm, PANDA_READY, random_postures
import numpy as np
import pytest

from redundant_planner.core.constants import limits_of
from redundant_planner.core.horizon.evasive_path import Demand, Due, improved, PathProblem
from redundant_planner.core.horizon.poses_ahead import poses_ahead
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import AXES, PlannerParameters
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose

NODES = 4
TIMES = 0.25 + 0.16 * np.arange(NODES)
DEMAND = Demand(1000.0, 0.005)


class Problem:
    """A problem and its price, written down once more."""

    def __init__(self, robot, q, previous, twist, obstacles, weights=None):
        self.robot, self.q, self.previous = robot, q, previous
        self.scaling = 1.0 / np.sqrt(np.ones(robot.n) if weights is None else weights)
        self.limits = limits_of(robot, PlannerParameters())
        self.obstacles = inflated_obstacles(
            Scene.of(obstacles), [c.radius for c in robot.capsules])
        arm, self.times = robot.kinematics(q), np.append(0.0, TIMES)
        along = robot.task_rows(twist)
        speed = np.linalg.norm(along)
        self.due = Due(
            poses_ahead(arm.tips, np.tile(twist, (NODES, 1)),
                        self.times, robot.in_tool),
            along / max(speed, 1e-12), speed * self.times[1:])

    def step(self, nodes, demand=DEMAND):
        return improved(PathProblem(
            self.q, self.previous, self.due, self.obstacles, self.robot.chain, self.limits,
            self.scaling, TIMES, demand), nodes)

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
        widths = np.diff(self.times)[:, None]
        since = np.vstack((widths[:1], 0.5 * (widths[1:] + widths[:-1])))
        rates = np.diff(np.vstack((self.q, nodes)), axis=0) / widths
        changes = np.diff(np.vstack((self.previous, rates)), axis=0) / since
        high, low = self.limits.positions
        most = np.full((NODES, 1), 0.8) * self.limits.acceleration_max
        most[0] *= 0.5
        excess = (100.0 * beyond(nodes, low, high).sum()
                  + beyond(rates, -0.9 * self.limits.velocity_max,
                           0.9 * self.limits.velocity_max).sum()
                  + (since ** 2 * beyond(changes, -most, most)).sum())
        short = np.square(np.minimum(self.distances(nodes) - DEMAND.reserve, 0.0)).sum()
        weights, step = self.scaling ** -2, TIMES[-1] / NODES
        motion = weights * widths * (1e-3 * rates ** 2 + 3e-3 * changes ** 2)
        return excess + motion.sum() + step * (
            np.square(self.errors(nodes)).sum() + 0.5 * DEMAND.price * short)

    def distances(self, nodes):
        """The distances (2 N, c, k), halfway to each node and there."""
        begins, times = np.vstack((self.q, nodes[:-1])), self.times
        seen = np.stack((0.5 * (begins + nodes), nodes), axis=1).reshape(-1, self.robot.n)
        seen_times = np.stack((0.5 * (times[1:] + times[:-1]), times[1:]), axis=1).ravel()
        arms = self.robot.kinematics_along(seen)
        return link_clearance(
            self.obstacles, arms.segment_start, arms.segment_end, seen_times).distance


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
def test_a_step_reports_what_its_path_is_like_and_makes_none_worse(make):
    better = 0
    for random, problem in problems(make, 20):
        nodes = problem.q + 0.3 * random.normal(size=(NODES, problem.robot.n))
        found = problem.step(nodes)
        assert found.price == pytest.approx(problem.price(found.nodes), rel=1e-9)
        assert found.price <= problem.price(nodes) * (1.0 + 1e-12)
        better += found.price < 0.9 * problem.price(nodes)
        errors = np.linalg.norm(problem.errors(found.nodes), axis=1)
        assert found.deviation == pytest.approx(errors.max(), rel=1e-9)
        assert found.at_end == pytest.approx(errors[-1], rel=1e-9)
        distances = problem.distances(found.nodes)
        if found.nearest < DEMAND.reserve:  # further away, a bound is enough
            _, link, obstacle = np.unravel_index(distances.argmin(), distances.shape)
            assert found.nearest == pytest.approx(distances.min(), abs=1e-9)
            assert (found.nearest_link, found.nearest_obstacle) == (link, obstacle)
    assert better > 15


def test_a_fast_obstacle_is_seen_between_two_nodes():
    """It passes the hand within a tenth of a second, and is nowhere near at any node."""
    robot, q = make_panda(), np.array(PANDA_READY)
    tip = robot.kinematics(q).tip_position
    halfway, velocity = 0.5 * (TIMES[1] + TIMES[2]), np.array([0.0, 5.0, 0.0])
    ball = Obstacle('ball', tip - halfway * velocity, [0.05] * 3, velocity=velocity)
    problem = Problem(robot, q, np.zeros(robot.n), np.zeros(6), [ball])
    found = problem.step(np.tile(q, (NODES, 1)))
    assert found.threatened and (found.nodes != q).any()


@pytest.mark.parametrize('make', [make_panda, lambda: make_panda(axes=AXES[:3]),
                                  make_paper_arm])
def test_steps_come_to_rest_where_the_price_has_hardly_a_slope(make):
    """Some rest at an edge, and the turn of a rotation's error is left out."""
    shares = []
    for _, problem in problems(make, 12):
        begin = np.tile(problem.q, (NODES, 1))
        nodes = problem.settled(begin)
        np.testing.assert_array_equal(problem.step(nodes).nodes, nodes)
        slopes = [np.abs(central_difference(
            lambda flat, problem=problem: problem.price(flat.reshape(NODES, -1)),
            at.ravel())).max() for at in (nodes, begin)]
        shares.append(slopes[0] / slopes[1])
    assert np.sum(np.array(shares) < 0.1) >= 11 and np.sum(np.array(shares) < 1e-6) >= 3


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
    ball = Obstacle('ball', middle + [0.0, 0.0, 0.08] - TIMES[-1] * velocity, [0.04] * 3,
                    velocity=velocity)
    problem = Problem(robot, q, np.zeros(robot.n), np.zeros(6), [ball])
    nodes = problem.settled(np.tile(q, (NODES, 1)))
    found = problem.step(nodes)
    assert found.threatened and found.nearest > 0.0
    still = Problem(robot, q, np.zeros(robot.n), np.zeros(6), [ball.after(TIMES[-1])])
    away = still.obstacles  # as near as it comes
    apart = [link_clearance(away, *(e[None] for e in (a.segment_start, a.segment_end)),
                            np.zeros(1)).distance.min()
             for a in (robot.kinematics(q), robot.kinematics(nodes[-1]))]
    assert apart[0] < -0.01 and apart[1] > 0.0

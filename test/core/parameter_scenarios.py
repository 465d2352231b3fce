"""Short closed loops in which single parameters show, for tests: parameters → motion."""

from __future__ import annotations

from dataclasses import dataclass

from closed_loop import DT
from conftest import make_panda, make_paper_arm, make_two_handed, PANDA_READY
import numpy as np

from redundant_planner.core.horizon.preview import Preview
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import AXES, PAPER_METHODS
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.step_result import StepResult
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.paper.method import PaperPlanner

PAPER_START = (0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0)
SINGULAR_START = (-0.294, 0.217, 2.128, -2.235, 0.463, 1.39, 1.337)
ROBOTS = {'paper': make_paper_arm(), 'panda': make_panda(),
          'panda_position': make_panda(axes=AXES[:3]), 'two_handed': make_two_handed()}
HANDS_IN_FRONT = (0.2, 0.0, 0.4, 0.3, 0.2, 0.9, 0.1, 0.4, 0.4, -0.3, -0.2, 0.9, -0.1, 0.4)


@dataclass(frozen=True)
class Ball:
    """A spherical obstacle: centre at first [m], radius [m] and velocity [m/s]."""

    center: tuple[float, float, float]
    radius: float = 0.03
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def at(self, time: float) -> np.ndarray:
        return np.array(self.center) + time * np.array(self.velocity)


@dataclass(frozen=True)
class Motion:
    """A closed loop: postures (k + 1, n) and results (k) of every tick, among balls."""

    robot: Robot
    postures: np.ndarray
    results: list[StepResult]
    balls: tuple[Ball, ...]


def move(parameters, robot, start, twist, seconds, *, balls=(), known=False, push=0.0):
    """Drive an arm with a constant twist; `push` is added to every joint after 0.1 s."""
    robot = ROBOTS[robot]
    twist = np.array([*twist, 0.0, 0.0, 0.0])[:6]
    kind = PaperPlanner if parameters.method in PAPER_METHODS else Planner
    planner = kind(robot, parameters)
    preview = Preview([0.0, seconds], [twist, twist])
    postures, results, scene = [np.array(start, dtype=float)], [], None
    for tick in range(round(seconds / DT)):
        if scene is None or any(any(ball.velocity) for ball in balls):
            scene = Scene.of([
                Obstacle(f'ball{i}', ball.at(tick * DT), np.full(3, ball.radius),
                         velocity=np.array(ball.velocity)) for i, ball in enumerate(balls)])
        q = postures[-1] + (push if tick == round(0.1 / DT) else 0.0)
        results.append(planner.step(q, twist, scene, DT,
                                    preview.ahead(tick * DT) if known else None))
        postures.append(q + DT * results[-1].dq)
    return Motion(robot, np.array(postures), results, balls)


def free(parameters):
    """The Panda's tip along a line, nothing near."""
    return move(parameters, 'panda', PANDA_READY, (0.0, 0.1, -0.05), 3.0)


def towards_each_other(parameters):
    """Two hands of one body until neither can go on."""
    robot, postures, results = ROBOTS['two_handed'], [np.array(HANDS_IN_FRONT)], []
    planner = Planner(robot, parameters)
    left, right = robot.kinematics(postures[0]).tip_positions
    twists = np.zeros((2, 6))
    twists[0, :3] = 0.1 * (right - left) / np.linalg.norm(right - left)
    twists[1] = -twists[0]
    for _ in range(900):
        results.append(planner.step(postures[-1], twists, [], DT))
        postures.append(postures[-1] + DT * results[-1].dq)
    return Motion(robot, np.array(postures), results, ())


def to_a_target_behind_a_ball(parameters):
    """The Panda's tip to a pose that a line leads to through a ball."""
    return _to_a_target(parameters, 0.3, 5.0)


def to_a_target_in_a_ball(parameters):
    """The Panda's tip to a pose that something else is at."""
    return _to_a_target(parameters, 0.5, 8.0)


def after_a_moving_target(parameters):
    """The Panda's tip after poses of a hand at 0.1 m/s, 50 of them a second."""
    robot, postures, results = ROBOTS['panda'], [np.array(PANDA_READY)], []
    planner, arm = Planner(robot, parameters), robot.kinematics(np.array(PANDA_READY))
    for tick in range(round(2.0 / DT)):
        target = Pose(arm.tip_position + (0.0, 0.1 * tick * DT, 0.0), arm.tip_rotation)
        news = [] if tick % round(0.02 / DT) else [Sighting(target, 0.0)]
        results.append(planner.step(postures[-1], np.zeros(6), Scene.of(), DT, target=target,
                                    news=news))
        postures.append(postures[-1] + DT * results[-1].dq)
    return Motion(robot, np.array(postures), results, ())


def _to_a_target(parameters, aside, seconds):
    robot, postures, results = ROBOTS['panda'], [np.array(PANDA_READY)], []
    planner, arm = Planner(robot, parameters), robot.kinematics(np.array(PANDA_READY))
    target = Pose(arm.tip_position + (0.0, 0.5, 0.0), arm.tip_rotation)
    ball = Ball(tuple(arm.tip_position + (0.0, aside, 0.0)), 0.06)
    scene = Scene.of([Obstacle('ball0', ball.at(0.0), np.full(3, ball.radius))])
    for _ in range(round(seconds / DT)):
        results.append(planner.step(postures[-1], np.zeros(6), scene, DT, target=target))
        postures.append(postures[-1] + DT * results[-1].dq)
    return Motion(robot, np.array(postures), results, (ball,))


def tilting(parameters):
    """The Panda's hand turns about a horizontal axis; its z axis points down at first."""
    return move(parameters, 'panda', PANDA_READY, (0.0, 0.0, 0.0, 0.3, 0.0, 0.0), 2.0)


def free_position(parameters):
    """The same line without its orientation: four joints to spare."""
    return move(parameters, 'panda_position', PANDA_READY, (0.0, 0.1, -0.05), 3.0)


def with_slow_drives(parameters, lag=0.06, dead_time=0.04):
    """The Panda's tip to and fro, driven late; quantities see what it was told to do."""
    robot, q, speed = ROBOTS['panda'], np.array(PANDA_READY), np.zeros(7)
    planner, late = Planner(robot, parameters), [np.zeros(7)] * round(dead_time / DT)
    postures, results = [q], []
    for tick in range(round(3.0 / DT)):
        twist = np.array([0.0, 0.2, -0.1, 0.0, 0.0, 0.0]) * np.sin(4.0 * tick * DT)
        results.append(planner.step(q, twist, Scene.of(), DT))
        late.append(results[-1].dq)
        speed = speed + (late.pop(0) - speed) * DT / lag
        q = q + DT * speed
        postures.append(q)
    return Motion(robot, np.array(postures), results, ())


def free_announced(parameters):
    """The same line with the paper arm, announced."""
    return move(parameters, 'paper', PAPER_START, (0.0, 0.1, -0.05), 3.0, known=True)


def held_up(parameters, known=False):
    """A ball in the way of the paper arm's last links: who turns away late loses time."""
    return move(parameters, 'paper', PAPER_START, (0.102, -0.04, -0.05), 3.0, known=known,
                balls=(Ball((0.185, 0.414, 0.782)),))


def held_up_announced(parameters):
    """The same; the planner knows the command in advance."""
    return held_up(parameters, known=True)


def towards_a_ball(parameters):
    """The Panda's forearm rises to a ball."""
    return move(parameters, 'panda', PANDA_READY, (0.0, 0.0, 0.08), 2.0,
                balls=(Ball((0.1137, 0.037, 0.902)),))


def between_two_balls(parameters):
    """The Panda's forearm passes one ball, then the other is the nearest."""
    return move(parameters, 'panda', PANDA_READY, (0.098, -0.017, -0.009), 2.0,
                balls=(Ball((0.252, -0.011, 0.848)), Ball((0.144, 0.063, 0.557))))


def into_the_forearm(parameters):
    """A ball moves into the resting Panda's forearm."""
    return move(parameters, 'panda', PANDA_READY, (0.0, 0.0, 0.0), 4.0,
                balls=(Ball((-0.3, 0.037, 0.697), 0.06, (0.2, 0.0, 0.0)),))


def into_the_first_link(parameters):
    """A ball moves into the resting paper arm's first link, which only the two rails carry."""
    velocity = np.array([0.014, 0.222, -0.202])
    return move(parameters, 'paper', (0.2, 0.2, *PAPER_START[2:]), (0.0, 0.0, 0.0), 3.5,
                balls=(Ball(tuple(np.array([0.016, 0.433, 0.324]) - 2.0 * velocity), 0.05,
                            tuple(velocity)),))


def across_the_first_link(parameters):
    """A ball moves across the same link, level."""
    return move(parameters, 'paper', PAPER_START, (0.0, 0.0, 0.0), 2.0,
                balls=(Ball((-0.45, 0.3, 0.15), 0.05, (0.3, 0.0, 0.0)),))


def folding(parameters):
    """The Panda's hand moves towards its shoulder."""
    return move(parameters, 'panda', PANDA_READY, (-0.2, 0.0, -0.05), 4.0)


def into_a_rail_end(parameters):
    """The paper arm up against the end of its first rail."""
    return move(parameters, 'paper', (0.35, *PAPER_START[1:]), (0.0, 0.0, 0.3), 3.0)


def stretching(parameters):
    """The Panda's hand away from its base until the arm is stretched out."""
    return move(parameters, 'panda', PANDA_READY, (0.3, 0.0, 0.1), 2.5)


def past_a_singularity(parameters):
    """Stretching that the four spare joints can put off."""
    return move(parameters, 'panda_position', SINGULAR_START, (0.032, -0.053, -0.079), 3.0)


def fast(parameters):
    """Forwards and turning, faster than the lower limits allow."""
    return move(parameters, 'panda', PANDA_READY, (0.1, 0.0, 0.0, 0.0, 0.0, 0.3), 1.0)


def pushed(parameters):
    """A Panda at rest is pushed by 0.02 rad in each joint and has 0.3 s to come back."""
    return move(parameters, 'panda', PANDA_READY, (0.0, 0.0, 0.0), 0.4, push=0.02)


def pushed_far(parameters):
    """The same by 0.1 rad, and 3 s."""
    return move(parameters, 'panda', PANDA_READY, (0.0, 0.0, 0.0), 3.1, push=0.1)

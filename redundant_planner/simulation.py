"""A motion offline: the planner in closed loop with an ideal arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math
from typing import Protocol

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError
from redundant_planner.core.horizon.preview import Preview, TwistAhead
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.step_result import StepResult
from redundant_planner.core.target.goal import Target

Array = npt.NDArray[np.float64]


class AnyPlanner(Protocol):
    """A planner that can be simulated: `Planner`, or the paper's method to the letter."""

    @property
    def robot(self) -> Robot:
        """The arm it plans for."""

    @property
    def parameters(self) -> PlannerParameters:
        """What it was made with."""

    def reset(self) -> None:
        """Begin a motion at rest."""

    def step(
        self, q: Array, twist: Array, scene: Scene, dt: float, ahead: TwistAhead | None = None,
        target: Target | None = None,
    ) -> StepResult:
        """Return the joint velocity for the next `dt`, as `Planner.step`."""


@dataclass(frozen=True)
class Motion:
    """A simulated motion of k ticks.

    Attributes:
        times: (k + 1,) from 0 [s].
        positions: (k + 1, n) joint positions [rad, m].
        velocities: (k, n) joint velocities, each held until the next time [rad/s, m/s].
        results: of the k ticks.
        clearance: (k + 1,) distance between the arm and the nearest obstacle [m]: never more
            than the true one, negative inside, infinite without obstacles. At the clearance
            margin it equals the margin.
    """

    times: Array
    positions: Array
    velocities: Array
    results: tuple[StepResult, ...]
    clearance: Array


def simulate(
    planner: AnyPlanner, start: npt.ArrayLike,
    twist: npt.ArrayLike | Callable[[float], npt.ArrayLike],
    scene: Scene | Sequence[Obstacle], duration: float, dt: float,
    preview: Preview | None = None, *, target: Target | None = None,
) -> Motion:
    """Run the planner from rest, in closed loop with an arm that follows at once.

    Obstacles with a velocity move on at that velocity.

    Args:
        planner: is reset first.
        start: (n,) joint positions [rad, m].
        twist: (6,) commanded tip twist [m/s, rad/s], or a function of the time [s] that returns
            it.
        scene: the obstacles at the start.
        duration: [s], rounded to whole ticks.
        dt: period of the loop [s].
        preview: the twists that will be commanded, over the time from the start; None if only
            the present one is known.
        target: a pose of the tip to go to, or joint positions (n,) [rad, m]; the twist does not
            count then.

    Raises:
        StateError: `start` or a twist does not fit the robot, or a time is not positive.
    """
    for name, value in (('duration', duration), ('dt', dt)):
        if not (math.isfinite(value) and value > 0.0):
            raise StateError(f'{name} is {value}; it must be positive [s]')
    scene = scene if isinstance(scene, Scene) else Scene.of(scene)
    robot, margin = planner.robot, planner.parameters.clearance_margin
    planner.reset()
    count = round(duration / dt)
    positions, clearance = np.empty((count + 1, robot.n)), np.empty(count + 1)
    positions[0] = robot.checked_posture(start)
    clearance[0] = _distance(robot, positions[0], scene, margin)
    results = []
    for i in range(count):
        now = i * dt
        result = planner.step(
            positions[i], np.asarray(twist(now) if callable(twist) else twist, dtype=float),
            _moved(scene, now), dt, None if preview is None else preview.ahead(now),
            target)
        results.append(result)
        positions[i + 1] = positions[i] + dt * result.dq
        clearance[i + 1] = _distance(robot, positions[i + 1], _moved(scene, now + dt), margin)
    return Motion(
        np.linspace(0.0, count * dt, count + 1, dtype=np.float64), positions,
        np.array([r.dq for r in results]).reshape(count, robot.n), tuple(results), clearance)


def _moved(scene: Scene, time: float) -> Scene:
    """Return the scene after a time [s]; the same object while nothing moves in it."""
    if not scene.velocities.any():
        return scene
    return replace(scene, centers=scene.centers + time * scene.velocities)


def _distance(robot: Robot, q: Array, scene: Scene, margin: float) -> float:
    """Return the distance to the nearest obstacle [m], exact at the margin, see `Motion`."""
    arm = robot.kinematics(q)
    maps = inflated_obstacles(scene, [c.radius + margin for c in robot.capsules],
                              moved=robot.moved)
    pairs = link_clearance(maps, arm.segment_start, arm.segment_end)
    return margin + float(pairs.distance.min(initial=np.inf))

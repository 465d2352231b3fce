"""Stepping aside: the joint path past obstacles that move, and when the arm follows it.

Whoever only keeps links away from where obstacles are leaves the path late, and is driven along in
front of them. This plan looks at their courses (`clearance.evasion_horizon`), and the tip may
leave its path in it. Where null-space motion alone gets past, the tip stays.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import Gains, RobotConstants
from redundant_planner.core.horizon.evasive_path import (
    CLEARANCE_PRICE,
    Demand,
    Due,
    Improved,
    improved,
    PathProblem,
    RESERVE,
)
from redundant_planner.core.horizon.poses_ahead import poses_ahead
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.nearby import Surroundings
from redundant_planner.core.redundancy.reference import reference_of, Start
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.safety.limits import Limits

Array = npt.NDArray[np.float64]

# Nodes, and how far apart they are at least and at most [s].
_NODES, _SHORTEST_STEP, _LONGEST_STEP = 12, 0.02, 0.25
# A path is improved at most this often, and where nothing threatens only this often [s].
_PERIOD, _IDLE_PERIOD = 0.003, 0.02
# A tip that shall be off its path by no more than this stays on it [m, rad].
_ON_PATH = 0.01
# Other paths begin where the arm has leaned aside along its null space, the joint that moves most
# by this much [rad, m] and within so many nodes. The last asks for less distance to begin with,
# instead of less strictly.
_LEANS, _LEANING_NODES = (0.0, 0.6, -0.6, 0.0), 5
# What is asked at the first step, and over how many steps it grows to all. Then a path settles.
_FIRST_PRICE, _FIRST_RESERVE = 1.0, -0.15
_GROWING, _SETTLING = 6, 3
_ALL = Demand(CLEARANCE_PRICE, RESERVE)
# Another path replaces the one that is followed if it costs less than this share.
_SHARE_TO_SWITCH = 0.9
# Time over which the acceleration goes over to that of the path [s].
_SMOOTHING_TIME = 0.03


class Aside(NamedTuple):
    """How the arm gets out of the way of what moves.

    Attributes:
        velocity: (n,) of the joints now [rad/s, m/s].
        leaves: whether the tip leaves its path; else null-space motion is enough.
        course: what would meet, in words.
    """

    velocity: Array
    leaves: bool
    course: str


@dataclass
class _Attempt:
    """Another path, on its way to be compared.

    Attributes:
        nodes: (N, n).
        from_afar: whether less distance is asked for at first.
        steps: taken so far.
    """

    nodes: Array
    from_afar: bool
    steps: int = 0

    @property
    def demand(self) -> Demand:
        """What the next step asks of clearances."""
        share = min(self.steps / _GROWING, 1.0)
        if self.from_afar:
            return Demand(CLEARANCE_PRICE, _FIRST_RESERVE + share * (RESERVE - _FIRST_RESERVE))
        return Demand(_FIRST_PRICE * (CLEARANCE_PRICE / _FIRST_PRICE) ** share, RESERVE)


class EvasivePlan:
    """The evasive path of one arm, from tick to tick.

    A step finds the best path near the one it begins with, not the best of all. So every other
    step goes to an attempt at another path, which replaces the one that is followed if it is
    clearly better. The order is fixed, and so is the result. No tick takes more than one step.

    The nodes stay where they are in time, and the first is given up when it comes near. Were they
    to move on with every tick, a path would be another one with every tick, too.
    """

    def __init__(
        self, robot: Robot, constants: RobotConstants, limits: Limits, gains: Gains,
    ) -> None:
        """Prepare for an arm, and for how long courses are looked at."""
        self._robot, self._limits, self._scaling = robot, limits, constants.scaling
        self._constants, self._gains = constants, gains
        self._between = min(max(
            gains.clearance_evasion_horizon / _NODES, _SHORTEST_STEP), _LONGEST_STEP)
        self.reset()

    def reset(self) -> None:
        """Forget the path."""
        self._path: Improved | None = None
        self._attempt: _Attempt | None = None
        self._until_first = 2.0 * self._between  # node of both [s]
        self._acceleration = np.zeros(self._robot.n)  # on the way of the path [rad/s², m/s²]
        self._is_away = False  # whether the path that is followed has left the commanded one
        self._course = ''
        self._attempts = 0
        self._has_followed = False  # whether the last step improved the path that is followed
        self._age = math.inf  # since the last step [s]
        self._due: tuple[Start, Surroundings] | None = None  # of the tick that a step belongs to

    def aside(self, start: Start, around: Surroundings) -> Aside | None:
        """Return how to get out of the way; None where nothing has to, or no way is known.

        Args:
            start: of the tick.
            around: the obstacles near the arm.
        """
        self.catch_up()
        self._move_on(start.dt)
        self._age += start.dt
        path = self._path
        leads = path is not None and (path.threatened or self._leads_back(path))
        if self._age >= (_PERIOD if leads else _IDLE_PERIOD):
            self._age, self._due = 0.0, (start, around)
        if path is None or not leads:
            self._acceleration, self._is_away = np.zeros(self._robot.n), False
            return None
        self._is_away = path.deviation > _ON_PATH
        share = 1.0 - math.exp(-start.dt / _SMOOTHING_TIME)
        self._acceleration = self._acceleration + share * (
            self._onto(path.nodes, start) - self._acceleration)
        return Aside(start.previous + start.dt * self._acceleration, self._is_away, self._course)

    def _leads_back(self, path: Improved) -> bool:
        """Return whether a path leads an arm that has stepped aside back to where it left."""
        return self._is_away and path.at_end < _ON_PATH < path.deviation

    def _onto(self, nodes: Array, start: Start) -> Array:
        """Return a tick's mean acceleration (n,) on the cubic that leads to the first node.

        It begins as the arm moves, and ends with the velocity of the parabola through the arm's
        posture and the first two nodes.
        """
        first, second = self._until_first, self._between
        here, ahead = (nodes[0] - start.arm.q) / first, (nodes[1] - nodes[0]) / second
        there = (second * here + first * ahead) / (first + second)
        s = min(start.dt / first, 1.0)
        return (6.0 * (1.0 - s) * here - (4.0 - 3.0 * s) * start.previous
                - (2.0 - 3.0 * s) * there) / first

    def catch_up(self) -> bool:
        """Take the step that the last tick has left; return whether there was one."""
        due, self._due = self._due, None
        if due is not None:
            self._step(*due)
        return due is not None

    def _move_on(self, dt: float) -> None:
        """Let a tick pass: give up the nodes that have come near."""
        self._until_first -= dt
        gone = math.ceil((self._between - self._until_first) / self._between)
        if gone <= 0:
            return
        self._until_first += gone * self._between
        if self._path is not None:
            self._path = self._path._replace(nodes=_without(self._path.nodes, gone))
        if self._attempt is not None:
            self._attempt.nodes = _without(self._attempt.nodes, gone)

    def _step(self, start: Start, around: Surroundings) -> None:
        """Improve the path that is followed, or in every other step the attempt at another."""
        path = self._path
        if path is None or not path.threatened or not self._has_followed:
            nodes = np.tile(start.arm.q, (_NODES, 1)) if path is None else path.nodes
            self._follow(self._improved(start, nodes, around.ahead, _ALL), around)
            return
        self._has_followed = False
        attempt = self._attempt or self._begun(start)
        found = self._improved(start, attempt.nodes, around.ahead, attempt.demand)
        attempt.steps += 1
        if found is None or attempt.steps > _GROWING + _SETTLING:
            self._attempt = None
            if found is not None and found.price < _SHARE_TO_SWITCH * path.price:
                self._follow(found, around)
        else:
            attempt.nodes, self._attempt = found.nodes, attempt

    def _follow(self, path: Improved | None, around: Surroundings) -> None:
        self._path, self._has_followed = path, True
        if path is None or not path.threatened:
            self._attempt = None
        else:
            link = self._robot.capsules[path.nearest_link].name
            obstacle = around.scene.names[around.nearest[path.nearest_obstacle]]
            self._course = f"link '{link}' in the course of obstacle '{obstacle}'"

    def _begun(self, start: Start) -> _Attempt:
        """Return the next attempt."""
        kind = self._attempts % len(_LEANS)
        self._attempts += 1
        nodes = np.tile(start.arm.q, (_NODES, 1))
        if _LEANS[kind] != 0.0 and self._robot.n > self._robot.m:
            spare = np.linalg.svd(start.arm.jacobian)[2][self._robot.m:]
            aside = spare[self._attempts // len(_LEANS) % len(spare)]
            aside = aside / aside[np.abs(aside).argmax()]
            share = np.minimum(np.arange(1, _NODES + 1) / _LEANING_NODES, 1.0)
            high, low = self._limits.positions
            nodes = nodes + np.outer(_LEANS[kind] * share, aside)
            nodes = np.minimum(np.maximum(nodes, low), high)
        return _Attempt(nodes, kind == len(_LEANS) - 1)

    def _improved(
        self, start: Start, nodes: Array, obstacles: InflatedObstacles, demand: Demand,
    ) -> Improved | None:
        """Return a path after a step; None where obstacles are too large for numbers."""
        robot, command = self._robot, start.command
        reference = reference_of(start, self._constants, self._gains)
        times: Array = self._until_first + self._between * np.arange(_NODES, dtype=float)
        poses = poses_ahead(reference, np.tile(command, (_NODES, 1)),
                            np.append(0.0, times), robot.in_tool)
        along = robot.task_rows(command)
        speed = math.sqrt(along @ along)
        due = Due(poses, along / speed if speed > 0.0 else along, speed * times)
        found = improved(PathProblem(
            start.arm.q, start.previous, due, obstacles, robot.chain, self._limits, self._scaling,
            times, demand), nodes)
        return found if math.isfinite(found.price) and np.isfinite(found.nodes).all() else None


def _without(nodes: Array, gone: int) -> Array:
    """Return a path without the first nodes; it stands still beyond the last."""
    return nodes[np.minimum(np.arange(len(nodes)) + gone, len(nodes) - 1)]

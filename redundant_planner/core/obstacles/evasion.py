"""Which way round: turns of the first joints, out of where obstacles are going.

A barrier turns a link away from where an obstacle is. A link moved by only one or two joints can
only go a few ways, though. Those away from an obstacle may lead along in front of it and into a
corner. Evasion therefore looks at the obstacles' courses (`courses.py`). If one leads into a link,
it gives the first joints, which carry all others, turns to try, small ones first. Each turn is
followed through time (`turns.py`). The arm makes the first one that keeps clear; if none does, the
one that falls least short of it.

A turn takes the tip off its path. Links moved by more joints are therefore left to the barriers,
which try null-space motion first, until these lead off the path themselves.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import Vector
from redundant_planner.core.obstacles.courses import deepest_threat
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.turns import (
    best_turn,
    Choice,
    CLEAR_DISTANCE,
    next_velocities,
    TurningJoints,
)
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# How many joints turn, and for how long each at full speed: every combination is tried [s].
_TURNING_JOINTS = 2
_TURN_DURATIONS = (
    0.0, 0.08, -0.08, 0.16, -0.16, 0.3, -0.3, 0.5, -0.5, 0.8, -0.8, 1.2, -1.2)
# How many turns a tick tries; all of them take 8 ticks. How many distances of links from obstacles
# it looks at for that, which bounds its time among many obstacles that move.
_MOST_TURNS = 24
_MOST_DISTANCES = 5000
# What a link counts that more joints move than turn: the other joints may still save it.
_WEIGHT_OF_OTHER_LINKS = 0.2
# Shares of a joint's limits that a turn uses: the rest of the arm moves, too.
_VELOCITY_SHARE, _ACCELERATION_SHARE = 0.9, 0.8
# A turn ends where standing still keeps this far from the obstacles' courses [m].
_SAFE_DISTANCE = 0.02
# A turn that is being made gives way to one that falls short by less than this share of its own.
_SHORTAGE_SHARE_TO_SWITCH = 0.8


class Turn(NamedTuple):
    """What the first joints shall do in a tick.

    Attributes:
        velocities: (k,) of the first k joints [rad/s, m/s]; none of them where nothing threatens.
        link, obstacle: what would meet.
    """

    velocities: Vector
    link: int
    obstacle: int


NO_TURN = Turn(np.empty(0), -1, -1)


class Evasion:
    """Turns of the first joints of one arm; remembers the one that is being made.

    Attributes:
        spent: how many distances of links from obstacles the last tick looked at.
        waited: how many ticks in a row have looked for no turn.
    """

    def __init__(self, robot: Robot, parameters: PlannerParameters) -> None:
        """Prepare for an arm, and what is to be kept from obstacles."""
        self._robot = robot
        self._margin, self._lead = parameters.clearance_margin, parameters.clearance_lead
        count = min(_TURNING_JOINTS, robot.n)
        self._position_min = robot.position_min[:count] + parameters.limits_position_margin
        self._position_max = robot.position_max[:count] - parameters.limits_position_margin
        moved_by = (robot.supports > 0.0).sum(axis=1)
        self._joints = TurningJoints(
            _VELOCITY_SHARE * robot.velocity_max[:count],
            _ACCELERATION_SHARE * robot.acceleration_max[:count],
            np.flatnonzero(robot.supports[:, :count].any(axis=1)),
            np.where(moved_by <= count, 1.0, _WEIGHT_OF_OTHER_LINKS),
            np.array(robot.lever_arm_bounds), parameters.clearance_evasion_horizon)
        # Of the links only those that no other joint moves.
        self._alone = self._joints._replace(
            links=self._joints.links[moved_by[self._joints.links] <= count])
        durations = sorted(itertools.product(_TURN_DURATIONS, repeat=count), key=np.linalg.norm)
        self._turns = np.array(durations) * robot.velocity_max[:count]
        self.reset()

    def reset(self) -> None:
        """Forget the turn that is being made."""
        self._target: Array | None = None
        # What the turn that is being made falls short, and whether that is to be looked at again.
        self._shortage, self._is_due = np.inf, True
        self._next = 0
        self.spent = 0
        self.waited = 0

    def turn(
        self, arm: Kinematics, obstacles: InflatedObstacles, previous: Array, leaving: bool,
        waits: bool, dt: float,
    ) -> Turn:
        """Return what the first joints shall do.

        Args:
            arm: its posture.
            obstacles: the obstacles, larger by the clearance margin and by the way that those
                that move make in `clearance.lead`.
            previous: (n,) velocity of the last tick [rad/s, m/s].
            leaving: whether the arm is leaving its path already.
            waits: whether the tick has other work to do that takes long. It then looks for no
                turn, and goes on with the one that is being made.
            dt: [s].
        """
        links, turning = self._robot.links(arm), self._target is not None
        threat = deepest_threat(
            links, obstacles, self._joints if turning or leaving else self._alone,
            -_SAFE_DISTANCE if turning else self._margin, self._lead)
        if threat.link < 0:
            self.reset()
            return NO_TURN

        count = len(self._position_min)
        q, velocities = arm.q[:count], previous[:count].copy()

        def best(turns: Array, limit: float, budget: int) -> Choice:
            choice = best_turn(links, obstacles, self._joints, velocities, turns, limit, budget,
                               self.spent == 0)
            self.spent += choice.distances
            return choice

        self.spent = 0
        tries = True
        self.waited = self.waited + 1 if waits else 0
        if waits:
            tries = False
        elif self._target is not None and self._is_due:
            self._shortage = best(self._target[None] - q, np.inf, 1).shortage
            # Where there is no time for both, the next tick tries others.
            tries = self._is_due = 2 * self.spent <= _MOST_DISTANCES
        else:
            self._is_due = True
        if tries and self._shortage > CLEAR_DISTANCE ** 2:
            until = min(self._next - self._next % _MOST_TURNS + _MOST_TURNS, len(self._turns))
            turns = np.minimum(np.maximum(
                self._turns[self._next:until], self._position_min - q), self._position_max - q)
            choice = best(
                turns, _SHORTAGE_SHARE_TO_SWITCH * self._shortage, _MOST_DISTANCES - self.spent)
            self._next = (self._next + choice.tried) % len(self._turns)
            # One that took more than was left comes first in the next tick.
            self._is_due = choice.tried > 0
            if choice.turn >= 0:
                self._target, self._shortage = q + turns[choice.turn], choice.shortage
        if self._target is None:  # obstacles too large for numbers
            return NO_TURN
        return Turn(next_velocities(self._target - q, velocities, self._joints, dt), *threat)

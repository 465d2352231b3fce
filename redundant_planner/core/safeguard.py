"""Guarding a tick: what of its wish may be commanded, and what holds the arm back, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.commands import Commands, possible_share
from redundant_planner.core.constants import joint_weights, limits_of, RobotConstants
from redundant_planner.core.errors import known
from redundant_planner.core.modes import Aim, LastTick
from redundant_planner.core.obstacles.clearance import pseudo_distance
from redundant_planner.core.obstacles.nearby import Surroundings
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.safety.barriers import (
    barrier_bounds,
    Barriers,
    barriers_in,
    Rows,
    with_rows,
    without_null_space,
)
from redundant_planner.core.safety.limits import braked, slowed_limits, stopping_time
from redundant_planner.core.safety.own_barriers import OwnRows
from redundant_planner.core.safety.reasons import reason_for
from redundant_planner.core.safety.slow_down import SlowDown
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.safety.stages import Filtered, safe_velocity
from redundant_planner.core.safety.way_out import LastWayOut
from redundant_planner.core.step_result import Nearest
from redundant_planner.core.tick import Wish

Array = npt.NDArray[np.float64]

# Stages that keep every clearance with the path kept: they may be those of a slower arm.
_SLOWER_STAGES = (Stage.SCALED, Stage.SLIDING, Stage.BRAKING)
# Stages that tell how much of a command can be followed.
_ON_PATH = (*_SLOWER_STAGES, Stage.STOPPED)
# Fastest joint of an arm that moves gently [rad/s, m/s].
_GENTLE = 0.05
# The joints of an arm that moves carefully can stop within this time [s].
_STOPS_WITHIN = 0.08


class Admitted(NamedTuple):
    """What may be commanded.

    Attributes:
        result: of the safety filter.
        possible: share of the command that could be followed, by an arm that nothing slows.
        says: what slows the arm down, and what holds it back; empty where nothing does.
    """

    result: Filtered
    possible: float
    says: tuple[str, str]

    @classmethod
    def untouched(cls, wanted: Array) -> Admitted:
        """Return a velocity (n,) as it is."""
        return cls(Filtered.untouched(wanted), 1.0, ('', ''))


class Safeguard:
    """What keeps one arm safe.

    Attributes:
        limits: of the joints.
    """

    def __init__(
        self, robot: Robot, parameters: PlannerParameters, constants: RobotConstants,
        commands: Commands, own: Sequence[str],
    ) -> None:
        """Prepare for an arm.

        Args:
            robot, parameters: the arm and its planner's.
            constants: made of these.
            commands: of the tips.
            own: names of the user's barriers.

        Raises:
            ParameterError: the parameters do not fit this robot.
        """
        self.limits = commands.limits(limits_of(robot, parameters))
        self._robot, self._parameters = robot, parameters
        self._commands, self._own = commands, own
        self._weights = joint_weights(robot, parameters)
        self._angular = robot.chain.rows % 6 >= 3
        self._slow_down = SlowDown(robot, parameters.slow_down)
        self._way_out = LastWayOut(robot, constants, self.limits, parameters.singularity_margin)

    def reset(self) -> None:
        """Forget what was found out about the posture."""
        self._way_out.forget()

    def nearest(self, desired: Wish, around: Surroundings) -> Nearest | None:
        """Return the link and obstacle that are nearest to each other; None without any."""
        link, obstacle = desired.nearest_link, desired.nearest_obstacle
        if link < 0:
            return None
        lead = self._parameters.clearance_lead * float(around.maps.speeds[obstacle])
        return Nearest(
            self._robot.capsules[link].name, around.scene.names[around.near[obstacle]],
            pseudo_distance(desired.nearest_normalized_distance), desired.nearest_distance + lead)

    def admitted(
        self, aim: Aim, desired: Wish, rows: Rows, scene: Scene, around: Surroundings,
        last: LastTick, own: OwnRows | None, *, gently: bool, carefully: bool,
    ) -> Admitted:
        """Return what may be commanded of what is wanted.

        Args:
            aim, desired: of the tick.
            rows: where its barriers are.
            scene, around: the obstacles, and those near the arm.
            last: what the tick before left.
            own: rows of the user's barriers; None without any.
            gently, carefully: see `Planner.step`.
        """
        mode, start = aim.mode, aim.start
        wanted = mode.wanted(desired)
        if own is not None and own.broken:
            result = _braking(start, self.limits.acceleration_max)
            return Admitted(result, result.scale, (
                '', f'{result.stage.value}: {known(own.broken)} is not a finite number'))
        share, slower = 1.0, ''
        if not mode.leaves:
            share, slower = self._slow_down.share(wanted, scene, start.arm)
            if gently or carefully:
                fastest = _GENTLE if gently else np.maximum(
                    _GENTLE, _STOPS_WITHIN * self.limits.acceleration_max)
                share = min(share, 1.0 / max(float((np.abs(wanted) / fastest).max()), 1.0))
        if mode.keeps_path and share == 1.0 and desired.admissible and (
                own is None or self._keeps(wanted, own, start)):
            return Admitted.untouched(wanted)
        barriers = barriers_in(rows, desired.rows_used)
        if own is not None:
            barriers = with_rows(barriers, own.barriers)
        result = self._filtered(aim, desired, wanted, barriers, last, share)
        if share < 1.0 and result.stage not in _SLOWER_STAGES:
            # A clearance that asks for a faster arm goes first.
            share, slower = 1.0, ''
            result = self._filtered(aim, desired, wanted, barriers, last, share)
        possible = 1.0
        if result.stage in _ON_PATH and (mode.keeps_path or mode.leaves):
            possible = possible_share(result, start.command)
        says = slower, self._reason(result, barriers, around, aim)
        return Admitted(result._replace(
            scale=share * result.scale,
            scales=None if result.scales is None else share * result.scales), possible, says)

    def _filtered(
        self, aim: Aim, desired: Wish, wanted: Array, barriers: Barriers, last: LastTick,
        share: float,
    ) -> Filtered:
        """Return the admissible velocity nearest to a share of the wanted one (n,)."""
        p, limits, mode, start = self._parameters, self.limits, aim.mode, aim.start
        if desired.unseen_share < 1.0:
            limits = limits._replace(velocity_max=slowed_limits(
                start.previous, limits.velocity_max, limits.acceleration_max,
                desired.unseen_share, start.dt))
        if not mode.keeps_path:
            barriers = without_null_space(barriers)
        ask = mode.ask(wanted, desired, start, last)
        request = self._commands.request(ask.request, start, desired.task, p.feedback_gain)
        if share < 1.0:
            request = request._replace(desired=share * wanted, twist=share * request.twist)
        return mode.rated(safe_velocity(
            request, limits, barriers, weights=self._weights, gain=ask.gain * p.clearance_gain,
            price=ask.price, slides=last.slid, may_slide=ask.may_slide,
            may_yield=mode.leaves or (desired.intruded and p.path_priority != 'strict'),
            leaves=mode.leaves, dt=start.dt, angular=self._angular), desired, start)

    def _keeps(self, dq: Array, own: OwnRows, start: Start) -> bool:
        """Return whether a velocity (n,) keeps the user's barriers."""
        stop = stopping_time(start.previous, self.limits.acceleration_max) + start.dt
        bounds = barrier_bounds(own.barriers, self._parameters.clearance_gain, stop, start.dt)
        return bool((own.barriers.gradient @ dq >= bounds).all())

    def _reason(
        self, result: Filtered, barriers: Barriers, around: Surroundings, aim: Aim,
    ) -> str:
        """Say what holds the arm back."""
        start = aim.start
        change = np.abs(result.dq - start.previous) / (start.dt * self.limits.acceleration_max)
        return reason_for(
            result, barriers, around, self._robot, change, start.arm.q, self._way_out, self._own,
            commanded=aim.commanded, course=aim.course)


def _braking(start: Start, acceleration_max: Array) -> Filtered:
    """Return a velocity with which all joints slow down in proportion."""
    slower = braked(start.previous, acceleration_max, start.dt)
    before = float(np.abs(start.previous).max())
    return Filtered.untouched(slower)._replace(
        scale=0.0, residual=float(np.abs(slower).max()) / before if before else 0.0,
        stage=Stage.BRAKING)

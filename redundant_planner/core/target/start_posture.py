"""A posture to start from: away from limits, singularities and the arm's own links."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import robot_constants
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# Random postures that are looked at, and how many of the best are improved.
_POSTURES, _IMPROVED = 1500, 6
# Steps of the improvement: the first and the last, as a share of what a joint may be asked for.
_FIRST_STEP, _LAST_STEP = 0.1, 0.004
_MOST_STEPS = 60
# With more of each than this, more is no better: the distance to a limit as a share of the
# range, the room between links as a share of the arm's reach, and the same of the height above
# the base plane of links, and of the tip and the elbow.
_AMPLE_RANGE, _AMPLE_ROOM, _AMPLE_HEIGHT, _UP = 0.2, 0.02, 0.15, 0.4
# What is no more than this share of ample makes a posture that much worse, and not useless.
_LEAST = 1e-3
# How much worse a posture is with every joint at ±π, with the tip behind the base, and with its
# z axis, along which most hands reach, straight up.
_TURNED, _BEHIND, _UPWARD = 0.8, 0.5, 0.5
# Digits that a person reads and types [rad, m].
_DIGITS = 2


def start_posture(robot: Robot, parameters: PlannerParameters | None = None) -> Array:
    """Return a posture (n,) from which the arm can move in every direction [rad, m].

    The same arm gets the same posture. It is the best of random ones, moved joint by joint to a
    better one as long as there is one. A posture's score is the product of these, each 1 at
    best:

    - the least distance of a joint to its limits, of its range; a fifth is enough;
    - √det(JJᵀ) and J's smallest singular value, relative to the best seen, and of both the
      geometric mean. The ratios have no unit, so lengths and angles need not be compared;
    - the least room between links that can collide, beyond their margin; 2 % of the reach is
      enough;
    - the height above the base plane, of the tip and of the highest joint between it and the
      first, the elbow: 40 % of the reach is enough for both; and that of the lowest link;
    - small joint angles count for more than large ones, a tip in front of the first joint (along
      x of the base) for more than one behind it, and a hand (z of the tip) that points down for
      more than one that points up.

    Joints without limits stand within ±π. What stands still around the arm is not known here,
    its own pedestal included, unless there are capsules around it.

    Args:
        robot: the arm.
        parameters: with the margins; the defaults if None.
    """
    judge = _Judge(robot, parameters or PlannerParameters())
    random = np.random.default_rng(0)
    postures = random.uniform(judge.low, judge.high, (_POSTURES, robot.n))
    # As the middle of every range is a good guess for most limits, half are nearer to it.
    postures[::2] = 0.5 * (postures[::2] + 0.5 * (judge.low + judge.high))
    seen = judge.look(postures)
    judge.compare_with(seen)
    scores = judge.scores(seen)
    best, best_score = postures[0], -math.inf
    for first in np.argsort(-scores, kind='stable')[:_IMPROVED]:
        found, score = _improved(judge, postures[first], float(scores[first]))
        if score > best_score:
            best, best_score = found, score
    return np.clip(np.round(best, _DIGITS) + 0.0, robot.position_min, robot.position_max)


def _improved(judge: _Judge, q: Array, score: float) -> tuple[Array, float]:
    """Return a posture near another one that no step of one joint makes better, and its score."""
    span, step = judge.high - judge.low, _FIRST_STEP
    steps = np.vstack((np.diag(span), -np.diag(span)))
    for _ in range(_MOST_STEPS):
        around = np.clip(q + step * steps, judge.low, judge.high)
        scores = judge.scores(judge.look(around))
        best = int(scores.argmax())
        if scores[best] > score:
            q, score = around[best], float(scores[best])
        elif step > _LAST_STEP:
            step *= 0.5
        else:
            break
    return q, score


class _Seen(NamedTuple):
    """What the score of N postures is made of.

    Attributes:
        q: (N, n) [rad, m].
        manipulability: (N,) √det(JJᵀ).
        smallest: (N,) singular value of J.
        room: (N,) between links, margin taken off [m]; infinite for links that cannot collide.
        tip: (N, 3) in the base frame, seen from the first joint in x and y [m].
        lowest: (N,) z of the lowest end of a link [m].
        elbow: (N,) z of the highest joint [m].
        upward: (N,) cosine of the angle of the tip's z axis to that of the base.
    """

    q: Array
    manipulability: Array
    smallest: Array
    room: Array
    tip: Array
    lowest: Array
    elbow: Array
    upward: Array


class _Judge:
    """Scores postures of one arm.

    Attributes:
        low, high: (n,) between which joints stand [rad, m].
    """

    def __init__(self, robot: Robot, parameters: PlannerParameters) -> None:
        constants = robot_constants(robot, parameters)
        margin = parameters.limits_position_margin
        limited = np.isfinite(robot.position_max - robot.position_min)
        self._limited = limited
        self.low = np.where(limited, robot.position_min + margin, -math.pi)
        self.high = np.where(limited, robot.position_max - margin, math.pi)
        self._robot, self._radii, self._pairs = robot, constants.radii, constants.self_pairs
        arm = robot.kinematics(np.clip(np.zeros(robot.n), self.low, self.high))
        self._turns = arm.joint_screws[3:].any(axis=0)
        # The first joint that turns: what it carries is in front of it or behind.
        first = int(self._turns.argmax())
        self._shoulder = robot.joint_points(arm.q)[first]
        self._best = self._steadiest = self._reach = 1.0

    def look(self, postures: Array) -> _Seen:
        """Return what is seen at postures (N, n)."""
        arms = self._robot.kinematics_along(postures)
        values: Array = np.asarray(np.linalg.svd(arms.jacobian, compute_uv=False), dtype=float)
        room, tips = np.full(len(postures), np.inf), len(self._robot.tips)
        lowest = arms.tip_positions[:, 2].reshape(-1, tips).min(axis=1)
        if len(self._pairs):
            room = np.array([
                link_distances(start, end, self._radii, self._pairs).distance.min()
                for start, end in zip(arms.segment_start, arms.segment_end)])
        if len(self._radii):
            lowest = np.minimum(lowest, np.minimum(
                arms.segment_start[..., 2], arms.segment_end[..., 2]).min(axis=1))
        tip = arms.tip_positions[::tips].copy()
        tip[:, :2] -= self._shoulder[:2]
        elbow = np.array([self._robot.joint_points(q)[:, 2].max() for q in postures])
        return _Seen(postures, values.prod(axis=1), values[:, -1], room, tip, lowest, elbow,
                     arms.tip_rotations[::tips, 2, 2])

    def compare_with(self, seen: _Seen) -> None:
        """Take the best of what is seen as what is possible."""
        self._best = max(float(seen.manipulability.max()), _LEAST ** 2)
        self._steadiest = max(float(seen.smallest.max()), _LEAST ** 2)
        self._reach = max(float(np.linalg.norm(
            seen.tip - np.array((0.0, 0.0, self._shoulder[2])), axis=1).max()), _LEAST)

    def scores(self, seen: _Seen) -> Array:
        """Return the scores (N,) of postures, 1 at best."""
        to_limit = np.minimum(seen.q - self.low, self.high - seen.q) / (self.high - self.low)
        to_limit = np.where(self._limited, to_limit, np.inf).min(axis=1)
        able = np.sqrt(np.minimum(seen.manipulability / self._best, 1.0)
                       * np.minimum(seen.smallest / self._steadiest, 1.0))
        turned = np.where(
            self._turns, np.minimum(np.abs(seen.q) / math.pi, 1.0) ** 2, 0.0).mean(axis=1)
        x, y = seen.tip[:, 0], seen.tip[:, 1]
        behind = 0.5 - 0.5 * x / np.maximum(np.hypot(x, y), 0.05 * self._reach)
        return np.asarray(
            _enough(to_limit / _AMPLE_RANGE) * np.maximum(able, _LEAST)
            * _enough(seen.room / (_AMPLE_ROOM * self._reach))
            * _enough(seen.tip[:, 2] / (_UP * self._reach))
            * _enough(seen.elbow / (_UP * self._reach))
            * _enough(1.0 + seen.lowest / (_AMPLE_HEIGHT * self._reach))
            * (1.0 - _TURNED * turned) * (1.0 - _BEHIND * behind)
            * (1.0 - _UPWARD * (0.5 + 0.5 * seen.upward)))


def _enough(share: Array) -> Array:
    """Return how much of ample something is (N,), 1 where it is ample or more."""
    return np.asarray(np.clip(share, _LEAST, 1.0))

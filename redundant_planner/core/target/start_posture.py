"""A posture to start from: away from limits, singularities and the arm's own links."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import robot_constants
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

# Random postures that are looked at, and how many of the best are improved.
_POSTURES, _IMPROVED = 1500, 6
# Steps of the improvement: the first and the last, as a share of what a joint may be asked for.
_FIRST_STEP, _LAST_STEP = 0.1, 0.004
_MOST_STEPS = 60
# With more of each than this, more is no better: the distance to a limit as a share of the
# range, the room between links as a share of the arm's reach, and the same of the height above
# the base plane of links, and of the tip and the elbow.
_AMPLE_RANGE, _AMPLE_ROOM, _AMPLE_HEIGHT, _UP = 0.2, 0.02, 0.15, 0.4
# What is no more than this share of ample makes a posture that much worse, and not useless. Links
# that touch make it worse than all of that: an arm that starts so may not get out.
_LEAST, _TOUCHING = 1e-3, 1e-30
# An arm hangs if no more of the postures in which its links do not touch, as a share, have the tip
# above the base plane.
_HANGS = 0.02
# How much worse a posture is with every joint at ±π, with the tip behind the base, and with its
# z axis, along which most hands reach, straight up.
_TURNED, _BEHIND, _UPWARD = 0.8, 0.5, 0.5
# Of several tips: the distance between hands, of an arm's reach, that is ample, how far below its
# shoulder heights are counted from, and how close to its limits 0 may be for a joint that moves
# them all to stand there, of its range.
_AMPLE_APART, _FLOOR, _NEAR_LIMIT = 0.4, 0.5, 0.2
# Joints count by how fast they are, up to this: a lift that creeps does not make up for an arm
# that is singular without it [rad/s, m/s].
_FAST = 0.5
# Joints that an arm of several has to itself at least.
_FEWEST = 3
# Digits that a person reads and types [rad, m].
_DIGITS = 2


def start_posture(robot: Robot, parameters: PlannerParameters | None = None) -> Array:
    """Return a posture (n,) from which the arm can move in every direction [rad, m].

    The same arm gets the same posture. It is the best of random ones, moved joint by joint to a
    better one as long as there is one. A posture's score is the product of these, each 1 at
    best:

    - the least distance of a joint to its limits, of its range; a fifth is enough;
    - √det(JJᵀ) and J's smallest singular value, relative to the best seen, and of both the
      geometric mean. The ratios have no unit, so lengths and angles need not be compared. Slow
      joints count for less;
    - the least room between links that can collide, beyond their margin; 2 % of the reach is
      enough;
    - the height above the base plane, of the tip and of the highest joint between it and the
      first, the elbow: 40 % of the reach is enough for both; and that of the lowest link. Of an
      arm that hangs below its base, as on a drone, only how far below the tip is;
    - small joint angles count for more than large ones, a tip in front of the first joint (along
      x of the base) for more than one behind it, and a hand (z of the tip) that points down for
      more than one that points up.

    Of several tips each counts: the product has the heights of each tip and elbow, and how far it
    is in front, from its own shoulder. Besides, hands are apart from each other, each on the side
    of its shoulder; two fifths of the reach are enough. Joints that move more than one tip, as a
    base, a lift and a waist do, stand at 0, or in the middle of a range that ends near 0.

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
    postures[:, judge.fixed] = judge.stand[judge.fixed]
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
    each = np.diag(span)[~judge.fixed]
    steps = np.vstack((each, -each))
    for _ in range(_MOST_STEPS * judge.tips):
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
        manipulability: (N,) √det(JJᵀ), slow joints' columns of J made smaller.
        smallest: (N,) singular value of that J.
        room: (N,) between links, margin taken off [m]; infinite for links that cannot collide.
        tip: (N, t, 3) in the base frame, seen from the first joint in x and y [m]; of several
            tips each from its shoulder, and in z from the height that it counts from.
        lowest: (N,) z of the lowest end of a link [m].
        elbow: (N, t) z of the highest joint [m], or of each arm's elbow.
        upward: (N, t) cosine of the angle of the tip's z axis to that of the base.
        apart: (N,) the least distance between hands along the line of their shoulders [m];
            infinite for one tip.
    """

    q: Array
    manipulability: Array
    smallest: Array
    room: Array
    tip: Array
    lowest: Array
    elbow: Array
    upward: Array
    apart: Array


class _Judge:
    """Scores postures of one arm.

    Attributes:
        low, high: (n,) between which joints stand [rad, m].
        fixed: (n,) whether a joint moves several tips, and is not varied.
        stand: (n,) where these stand [rad, m].
        tips: their number.
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
        self._haste = np.minimum(robot.velocity_max / _FAST, 1.0)
        self._best = self._steadiest = self._reach = 1.0
        self._hangs = False
        own = robot.chain.tip_supports > 0.0
        self.tips, self.fixed = len(own), own.sum(axis=0) > 1
        if (own & ~self.fixed).sum(axis=1).min() < _FEWEST:  # they are not on arms of their own
            self.fixed = np.zeros(robot.n, dtype=bool)
        near = _NEAR_LIMIT * (self.high - self.low)
        self.stand = np.where((self.low + near < 0.0) & (self.high - near > 0.0), 0.0,
                              0.5 * (self.low + self.high))
        self._arms = [_Arm.of(robot, arm.q, np.flatnonzero(joints & ~self.fixed), t)
                      for t, joints in enumerate(own)] if self.tips > 1 else []

    def look(self, postures: Array) -> _Seen:
        """Return what is seen at postures (N, n)."""
        arms = self._robot.kinematics_along(postures)
        values: Array = np.asarray(
            np.linalg.svd(arms.jacobian * self._haste, compute_uv=False), dtype=float)
        room, tips = np.full(len(postures), np.inf), len(self._robot.tips)
        lowest = arms.tip_positions[:, 2].reshape(-1, tips).min(axis=1)
        if len(self._pairs):
            room = np.array([
                link_distances(start, end, self._radii, self._pairs).distance.min()
                for start, end in zip(arms.segment_start, arms.segment_end)])
        if len(self._radii):
            lowest = np.minimum(lowest, np.minimum(
                arms.segment_start[..., 2], arms.segment_end[..., 2]).min(axis=1))
        tip = arms.tip_positions.reshape(-1, tips, 3).copy()
        points = np.array([self._robot.joint_points(q) for q in postures])
        apart = np.full(len(postures), np.inf)
        if self._arms:
            apart = self._apart(tip, points)
            lowest, elbow = np.zeros(len(postures)), np.empty(tip.shape[:2])
            for t, own in enumerate(self._arms):
                seen_from = points[:, own.shoulder] - (0.0, 0.0, _FLOOR * own.reach)
                tip[:, t] -= seen_from
                elbow[:, t] = points[:, own.elbow, 2] - seen_from[:, 2]
        else:
            tip[..., :2] -= self._shoulder[:2]
            elbow = points[..., 2].max(axis=1)[:, None]
        return _Seen(postures, values.prod(axis=1), values[:, -1], room, tip, lowest, elbow,
                     arms.tip_rotations[:, 2, 2].reshape(-1, tips), apart)

    def _apart(self, tip: Array, points: Array) -> Array:
        """Return how far hands (N, t, 3) are apart, of arms with joints at (N, n + 1, 3) [m]."""
        found = [np.full(len(tip), np.inf)]
        for a, b in itertools.combinations(range(self.tips), 2):
            line = points[:, self._arms[a].shoulder] - points[:, self._arms[b].shoulder]
            line /= np.maximum(np.linalg.norm(line, axis=1), _LEAST)[:, None]
            found.append(((tip[:, a] - tip[:, b]) * line).sum(axis=1))
        return np.asarray(np.min(found, axis=0))

    def compare_with(self, seen: _Seen) -> None:
        """Take the best of what is seen as what is possible."""
        self._best = max(float(seen.manipulability.max()), _LEAST ** 2)
        self._steadiest = max(float(seen.smallest.max()), _LEAST ** 2)
        if self._arms:
            self._reach = max(arm.reach for arm in self._arms)
            return
        self._reach = max(float(np.linalg.norm(
            seen.tip[:, 0] - np.array((0.0, 0.0, self._shoulder[2])), axis=1).max()), _LEAST)
        above = seen.tip[seen.room > 0.0, 0, 2] > 0.0
        self._hangs = bool(len(above)) and float(above.mean()) <= _HANGS

    def scores(self, seen: _Seen) -> Array:
        """Return the scores (N,) of postures, 1 at best."""
        to_limit = np.minimum(seen.q - self.low, self.high - seen.q) / (self.high - self.low)
        to_limit = np.where(self._limited, to_limit, np.inf).min(axis=1)
        able = np.sqrt(np.minimum(seen.manipulability / self._best, 1.0)
                       * np.minimum(seen.smallest / self._steadiest, 1.0))
        turned = np.where(
            self._turns, np.minimum(np.abs(seen.q) / math.pi, 1.0) ** 2, 0.0).mean(axis=1)
        x, y = seen.tip[..., 0], seen.tip[..., 1]
        behind = 0.5 - 0.5 * x / np.maximum(np.hypot(x, y), 0.05 * self._reach)
        height = seen.tip[..., 2] / (_UP * self._reach)
        high = _enough(-height).prod(axis=1) if self._hangs else (
            _enough(height).prod(axis=1)
            * _enough(seen.elbow / (_UP * self._reach)).prod(axis=1)
            * _enough(1.0 + seen.lowest / (_AMPLE_HEIGHT * self._reach)))
        return np.asarray(
            _enough(to_limit / _AMPLE_RANGE) * np.maximum(able, _LEAST)
            * np.where(seen.room > 0.0, 1.0, _TOUCHING)
            * _enough(seen.room / (_AMPLE_ROOM * self._reach)) * high
            * (1.0 - _TURNED * turned) * (1.0 - _BEHIND * behind).prod(axis=1)
            * (1.0 - _UPWARD * (0.5 + 0.5 * seen.upward)).prod(axis=1)
            * _enough(seen.apart / (_AMPLE_APART * self._reach)))


class _Arm(NamedTuple):
    """One of several arms.

    Attributes:
        shoulder, elbow: the first of its joints, and the one half way to the tip.
        reach: of the stretched arm from the shoulder [m].
    """

    shoulder: int
    elbow: int
    reach: float

    @classmethod
    def of(cls, robot: Robot, q: Array, own: Indices, tip: int) -> _Arm:
        """Measure an arm with these joints at a posture (n,)."""
        points = np.vstack((robot.joint_points(q)[own],
                            robot.kinematics(q).tip_positions[tip:tip + 1]))
        along = np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()
        middle = int(np.abs(along - 0.5 * along[-1]).argmin()) + 1
        return cls(int(own[0]), int(own[min(middle, len(own) - 1)]),
                   max(float(along[-1]), _LEAST))


def _enough(share: Array) -> Array:
    """Return how much of ample something is (N,), 1 where it is ample or more."""
    return np.asarray(np.clip(share, _LEAST, 1.0))

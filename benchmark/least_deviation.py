"""The motion that leaves a path least while obstacles move through the arm as it knows they will.

Direct transcription with CasADi and IPOPT. The joint path is a uniform quadratic B-spline. Its
velocity runs straight from one difference of control points to the next, and its acceleration is
constant in between. So bounds on these differences keep the limits of velocity and acceleration
at every instant. Clearances and deviations are looked at on each knot and half way to the next.

It leaves out what would only ask for more: jerk limits, self-collision, singularities. Pairs of
link and obstacle are left out where no start takes them near to each other. Whoever needs
certainty measures what comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from benchmark.generator import DURATION, Task
from benchmark.optimum import forward
from benchmark.symbolic_clearance import clearance
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

# IPOPT sees the largest deviation squared, in this unit [m].
_UNIT = 0.1
# The price of ∫ q̇ᵀq̇ dt beside it. It chooses between motions that deviate alike, and makes them
# deviate by well below 1 mm more.
_EFFORT = 1e-4
_TOLERANCE = 1e-4
_ITERATIONS = 250
# How near to each other a link and an obstacle have to come in a start to be looked at [m].
_NEAR = 0.35
# Motions this near in what is minimised are the same: 1 % in the deviation.
_ALIKE = 0.02
# A deviation this small is none, in `_UNIT`.
_NOTHING = 0.01
# Poses of a path that the tip is compared with.
_SHARES = 301


class Path(NamedTuple):
    """Where the tip shall go: along a line while it turns about one axis.

    Attributes:
        start: where it begins.
        way: (3,) that it leads [m].
        turn: (3,) that it turns, a rotation vector in the base frame [rad].
    """

    start: Pose
    way: Array
    turn: Array

    @classmethod
    def of(cls, robot: Robot, task: Task) -> Path:
        """Return a task's path."""
        if robot.in_tool:
            raise ValueError('twists in the axes of the tip lead along no line')
        arm = robot.kinematics(task.start)
        whole = 0.5 * DURATION * task.twist  # ∫ sin² is half the duration
        return cls(Pose(arm.tip_position, arm.tip_rotation), whole[:3], whole[3:])

    def deviations(self, robot: Robot, postures: Array, lever: float) -> Array:
        """Return how far the tip is from the nearest pose of the path, at postures (k, n) [m].

        √(‖Δp‖² + (lever · 2 sin ½θ)²), with θ the angle between the orientations.
        """
        shares = np.linspace(0.0, 1.0, _SHARES)
        wanted = self.start.position + np.outer(shares, self.way)
        rotations = np.array([pin.exp3(share * self.turn) for share in shares])
        rotations = (rotations @ self.start.rotation).reshape(_SHARES, 9)
        found = []
        for q in postures:
            arm = robot.kinematics(q)
            squared = np.square(wanted - arm.tip_position).sum(axis=1)
            squared += 0.5 * lever ** 2 * np.square(
                rotations - arm.tip_rotation.ravel()).sum(axis=1)
            found.append(squared.min())
        return np.sqrt(found)


class LeastDeviation:
    """Solves one task from several starts."""

    def __init__(
        self, robot: Robot, task: Task, seconds: float, motions: Sequence[Array], *,
        lever: float = 0.0, margin: float | None = None, step: float = 0.16,
    ) -> None:
        """Write the problem down; solving is `best`.

        Args:
            robot: the arm, at rest at the task's start.
            task: its obstacles keep their velocities.
            seconds: after which the tip is back on its path.
            motions: starts: postures (k, n), evenly over the time.
            lever: what a radian of the tip's orientation counts beside a metre [m]; 0 leaves the
                orientation free until the end.
            margin: kept between links and obstacles [m]; the planner's if None.
            step: between two knots [s].
        """
        self._robot, self._task, self._step = robot, task, step
        self._count = round(seconds / step)
        p = PlannerParameters()
        self._margin = p.clearance_margin if margin is None else margin
        self._low = robot.position_min + p.limits_position_margin
        self._high = robot.position_max - p.limits_position_margin
        self._path, self._lever = Path.of(robot, task), lever
        self._starts = [self._control_points(motion) for motion in motions]
        self._solver, self._bounds = self._problem()

    def best(self) -> Array | None:
        """Return the control points (K + 2, n) that deviate least; None where no start led to any.

        Ends once two starts have led to the least, or one to a motion on the path.
        """
        least, best = np.inf, None
        for start in self._starts:
            begin = start[2:]
            shares = np.linspace(0.0, 1.0, 2 * self._count)
            found = self._solver(
                x0=np.concatenate((begin.ravel(), shares, [1.0])), **self._bounds)
            if not self._solver.stats()['success']:
                continue
            now, before = float(found['f']), least
            if now < least:
                least = now
                points = np.array(found['x'])[:begin.size].reshape(begin.shape)
                best = np.vstack((self._task.start, self._task.start, points))
            largest = float(found['x'][-1])
            if abs(now - before) < _ALIKE * least or largest < _NOTHING ** 2:
                break
        return best

    def postures(self, points: Array, dt: float) -> Array:
        """Return the postures (k, n) of control points, every dt [s]."""
        at = np.arange(0.0, self._count * self._step + 0.5 * dt, dt) / self._step
        first = np.minimum(at.astype(int), self._count - 1)
        u = (at - first)[:, None]
        return (0.5 * (1.0 - u) ** 2 * points[first] + (0.5 + u * (1.0 - u)) * points[first + 1]
                + 0.5 * u ** 2 * points[first + 2])

    def _control_points(self, motion: Array) -> Array:
        """Return control points (K + 2, n) of a motion (k, n), inside the positions' limits.

        A point belongs half a step before its knot. The first two are the start, at rest.
        """
        times = (np.arange(self._count + 2) - 0.5) / self._count
        along = np.linspace(0.0, 1.0, len(motion))
        points = np.array([np.interp(times, along, column) for column in motion.T]).T
        return np.clip(points, self._low, self._high)

    def _problem(self) -> tuple[ca.Function, dict[str, Array]]:
        """Return the solver over [points, shares of the path, largest deviation²], and bounds."""
        n, count, step, start = self._robot.n, self._count, self._step, self._task.start
        free = ca.MX.sym('points', n, count)
        shares = ca.MX.sym('shares', 1, 2 * count)
        largest = ca.MX.sym('largest')
        points = ca.horzcat(ca.DM(start), ca.DM(start), free)
        before, middle, after = points[:, :-2], points[:, 1:-1], points[:, 2:]
        halves, knots = (before + 6.0 * middle + after) / 8.0, 0.5 * (middle + after)
        postures = ca.reshape(ca.vertcat(halves, knots), n, 2 * count)
        times = ca.DM(0.5 * step * np.arange(1, 2 * count + 1)).T
        looked_at, end = self._functions()
        off, clear = looked_at.map(2 * count)(postures, shares, times)
        speeds, changes = after - middle, after - 2.0 * middle + before
        fastest = step * self._robot.velocity_max
        hardest = step ** 2 * self._robot.acceleration_max
        rows = [
            (ca.vec(speeds / fastest), -1.0, 1.0), (ca.vec(changes / hardest), -1.0, 1.0),
            (ca.vec(clear)[self._near_rows().tolist()], 0.0, np.inf),
            (ca.vec(largest - off), 0.0, np.inf),
            (end(postures[:, -1], shares[-1]), 0.0, 0.0)]
        solver = ca.nlpsol(
            'least', 'ipopt',
            {'x': ca.vertcat(ca.vec(free), ca.vec(shares), largest),
             'f': largest + _EFFORT / step * ca.sumsqr(speeds),
             'g': ca.vertcat(*(row for row, _, _ in rows))},
            {'ipopt.print_level': 0, 'print_time': False, 'ipopt.sb': 'yes',
             'expand': True, 'ipopt.max_iter': _ITERATIONS, 'ipopt.tol': _TOLERANCE})
        sizes = [row.numel() for row, _, _ in rows]
        # A path that leads nowhere has no shares to choose.
        furthest = float(self._task.twist.any())
        return solver, {
            'lbx': np.concatenate((np.tile(self._low, count), np.zeros(2 * count), [0.0])),
            'ubx': np.concatenate((np.tile(self._high, count), np.full(2 * count, furthest),
                                   [np.inf])),
            'lbg': np.concatenate([np.full(k, low) for k, (_, low, _) in zip(sizes, rows)]),
            'ubg': np.concatenate([np.full(k, high) for k, (_, _, high) in zip(sizes, rows)])}

    def _near_rows(self) -> npt.NDArray[np.intp]:
        """Return which clearances to look at, of those of every link and obstacle in turn."""
        links, obstacles = self._robot.capsules, self._task.obstacles
        near = np.zeros((2 * self._count, len(links), len(obstacles)), dtype=bool)
        for start in self._starts:
            postures = self.postures(start, 0.5 * self._step)[1:]
            for look, q in enumerate(postures):
                arm = self._robot.kinematics(q)
                middle = 0.5 * (arm.segment_start + arm.segment_end)
                half = 0.5 * np.linalg.norm(arm.segment_end - arm.segment_start, axis=1)
                for i, obstacle in enumerate(obstacles):
                    center = obstacle.center + 0.5 * self._step * (look + 1) * obstacle.velocity
                    reaches = half + obstacle.half_extents.max() + _NEAR + np.array(
                        [link.radius for link in links])
                    near[look, :, i] |= np.linalg.norm(middle - center, axis=1) < reaches
        return np.flatnonzero(near)

    def _functions(self) -> tuple[ca.Function, ca.Function]:
        """Return what is looked at in an instant, and what has to be zero at the end.

        The first takes a posture, the share of the path that the tip belongs to, and the time, to
        the deviation squared and the clearances; the second the first two to the pose's error.
        """
        path = self._path
        q, share, time = ca.SX.sym('q', self._robot.n), ca.SX.sym('share'), ca.SX.sym('time')
        tip, ends = forward(self._robot, q)
        away = path.start.position + share * path.way - tip[:3, 3]
        wanted = ca.mtimes(_turned(path.turn, share), path.start.rotation)
        apart = wanted - tip[:3, :3]
        off = ca.sumsqr(away) + 0.5 * self._lever ** 2 * ca.sumsqr(apart)
        clear = [
            clearance(obstacle, start - time * obstacle.velocity, end - time * obstacle.velocity,
                      float(np.linalg.norm(link.end - link.start)), link.radius + self._margin)
            for link, (start, end) in zip(self._robot.capsules, ends)
            for obstacle in self._task.obstacles]
        turned = ca.mtimes(wanted, tip[:3, :3].T)
        error = ca.vertcat(away / _UNIT, ca.inv_skew(0.5 * (turned - turned.T)))
        controlled = self._robot.task_rows(np.arange(6)).astype(int).tolist()
        return (
            ca.Function('looked_at', [q, share, time], [off / _UNIT ** 2, ca.vertcat(*clear)]),
            ca.Function('end', [q, share], [error[controlled]]))


def _turned(vector: Array, share: ca.SX) -> ca.SX:
    """Return the rotation (3, 3) by a share of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return ca.SX(np.eye(3))
    skew = ca.skew(vector / angle)
    return (ca.SX(np.eye(3)) + ca.sin(share * angle) * skew
            + (1.0 - ca.cos(share * angle)) * ca.mtimes(skew, skew))

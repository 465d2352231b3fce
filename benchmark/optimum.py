"""The shortest joint path of all for a task: direct transcription with CasADi and IPOPT.

The problem of Eqs. 11 and 12 over the whole motion at once, with every link clear of every
obstacle and the joints inside their limits, the same margins as the planner's. It leaves out
what would only make it longer: velocity and acceleration limits, self-collision, singularities.
CasADi and IPOPT come with `pip install casadi`, for this benchmark only.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

from benchmark.symbolic_clearance import clearance
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

INTERVALS = 80
# A start is bent aside for this long, at these speeds [s, rad/s].
_BEND = 1.5
_SPEEDS = (0.0, 0.3, -0.3, 0.6, -0.6, 1.0, -1.0)
_TOLERANCE = 1e-6


class Optimum:
    """Solves one task from several starts."""

    def __init__(
        self, robot: Robot, start: Array, poses: Sequence[Pose | None], step: float,
        obstacles: Sequence[Obstacle], margin: float,
    ) -> None:
        """Write the problem down; solving is `best`.

        Args:
            robot: the arm.
            start: (n,) posture.
            poses: where the tip has to be, from the start on; None where it may be anywhere.
                Not at the end: a goal has its pose there.
            step: between them [s].
            obstacles: that stand still.
            margin: kept between links and obstacles [m].
        """
        self._robot, self._start, self._margin = robot, start, margin
        at = np.linspace(0, len(poses) - 1, INTERVALS + 1).round().astype(int)
        self._times = at * step
        self._poses = [poses[i] for i in at]
        self._obstacles = obstacles
        p = PlannerParameters()
        self._low = robot.position_min + p.limits_position_margin
        self._high = robot.position_max - p.limits_position_margin
        self._solver, self._bounds = self._problem()

    def best(self, paths: Iterable[Array]) -> tuple[float, Array] | None:
        """Return the least ∫ q̇ᵀq̇ dt found and its postures (K + 1, n); None if none was.

        Args:
            paths: starts: postures (k, n) over the motion. If the tip has a path, bent
                least-norm ones come besides these.
        """
        found: tuple[float, Array] | None = None
        starts = [self._resampled(path) for path in paths]
        if all(pose is not None for pose in self._poses):
            starts += [self._bent(speed) for speed in _SPEEDS]
        for start in starts:
            result = self._solver(
                x0=start[1:].ravel(), lbx=np.tile(self._low, INTERVALS),
                ubx=np.tile(self._high, INTERVALS), lbg=self._bounds[0], ubg=self._bounds[1])
            if not self._solver.stats()['success']:
                continue
            cost = float(result['f'])
            if found is None or cost < found[0]:
                nodes = np.array(result['x']).reshape(INTERVALS, -1)
                found = cost, np.vstack((self._start, nodes))
        return found

    def _problem(self) -> tuple[ca.Function, tuple[Array, Array]]:
        robot, n = self._robot, self._robot.n
        q = ca.SX.sym('q', n)
        tip, ends = forward(robot, q)
        pose = ca.SX.sym('pose', 12)
        wanted = ca.reshape(pose[3:], 3, 3)
        turned = ca.mtimes(wanted, tip[:3, :3].T)
        error = ca.vertcat(
            pose[:3] - tip[:3, 3],
            0.5 * ca.vertcat(turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0],
                             turned[1, 0] - turned[0, 1]))
        rows = robot.task_rows(np.arange(6)).astype(int).tolist()
        clear = [
            clearance(obstacle, *ends[i], float(np.linalg.norm(link.end - link.start)),
                      link.radius + self._margin)
            for i, link in enumerate(robot.capsules) for obstacle in self._obstacles]
        node = ca.Function('node', [q, pose], [error[rows], ca.vertcat(*clear)])

        path = ca.SX.sym('path', n, INTERVALS)
        previous, cost = ca.SX(self._start), ca.SX(0.0)
        constraints, low, high = [], [], []
        for i in range(INTERVALS):
            now = path[:, i]
            step = self._times[i + 1] - self._times[i]
            cost += ca.sumsqr(now - previous) / step
            wanted_now = self._poses[i + 1] or Pose(np.zeros(3), np.eye(3))
            gap, clearances = node(now, np.concatenate(
                (wanted_now.position, wanted_now.rotation.T.ravel())))
            if self._poses[i + 1] is not None:
                constraints.append(gap)
                low += [0.0] * len(rows)
                high += [0.0] * len(rows)
            constraints.append(clearances)
            low += [0.0] * len(clear)
            high += [np.inf] * len(clear)
            previous = now
        solver = ca.nlpsol(
            'shortest', 'ipopt',
            {'x': ca.vec(path), 'f': cost, 'g': ca.vertcat(*constraints)},
            {'ipopt.print_level': 0, 'print_time': False, 'ipopt.sb': 'yes',
             'ipopt.max_iter': 300, 'ipopt.tol': _TOLERANCE})
        return solver, (np.array(low), np.array(high))

    def _resampled(self, path: Array) -> Array:
        times = np.linspace(0.0, self._times[-1], len(path))
        return np.array([np.interp(self._times, times, column) for column in path.T]).T

    def _bent(self, speed: float) -> Array:
        """Return least-norm postures that also move along the null space in the beginning."""
        robot, q = self._robot, self._start
        aside = np.random.default_rng(0).normal(size=robot.n)
        path = [q]
        for i, pose in enumerate(self._poses[1:]):
            assert pose is not None
            step = self._times[i + 1] - self._times[i]
            jacobian = robot.kinematics(q).jacobian
            inverse = np.linalg.pinv(jacobian, rcond=0.02)
            aside = aside - inverse @ (jacobian @ aside)
            aside /= np.linalg.norm(aside)
            if self._times[i] < _BEND:
                q = q + speed * step * aside
            for _ in range(3):
                arm = robot.kinematics(q)
                error = se3.pose_error(
                    pose, Pose(arm.tip_position, arm.tip_rotation), robot.in_tool)
                q = q + np.linalg.pinv(arm.jacobian, rcond=0.02) @ robot.task_rows(error)
            q = np.clip(q, self._low, self._high)
            path.append(q)
        return np.array(path)


def forward(robot: Robot, q: ca.SX) -> tuple[ca.SX, list[tuple[ca.SX, ca.SX]]]:
    """Return the tip's transform (4, 4) and both ends of every capsule, in the base frame."""
    model = robot.model
    placements = [ca.SX(np.eye(4))]
    for i in range(1, robot.n + 1):
        subspace = np.array(model.joints[i].createData().S).reshape(6)
        placements.append(ca.mtimes(
            placements[-1], ca.mtimes(model.jointPlacements[i].homogeneous,
                                      _moved(subspace, q[i - 1]))))
    tip = model.frames[model.getFrameId(robot.tip_frame)]
    ends = []
    for capsule in robot.capsules:
        frame = model.frames[model.getFrameId(capsule.frame)]
        at = placements[frame.parentJoint]
        ends.append(tuple(
            ca.mtimes(at, np.append(frame.placement.act(np.array(end)), 1.0))[:3]
            for end in (capsule.start, capsule.end)))
    return ca.mtimes(placements[tip.parentJoint], tip.placement.homogeneous), ends


def _moved(subspace: Array, q: ca.SX) -> ca.SX:
    """Return the transform (4, 4) of a joint about or along its axis (Rodrigues)."""
    result = ca.SX(np.eye(4))
    x, y, z = subspace[3:]
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    result[:3, :3] += ca.sin(q) * skew + (1.0 - ca.cos(q)) * (skew @ skew)
    result[:3, 3] = subspace[:3] * q
    return result

"""OSCBF's velocity controller (Morton and Pavone 2025) on cbfpy, driven tick by tick.

The nominal velocity is the least norm one that takes the tip to where it should be, without a
posture to prefer; the filter changes it as little as it can, in the task and in the null space.
Gains and weights are those of OSCBF's tabletop example. OSCBF pins an older cbfpy and covers
links with spheres; here the barriers are exact distances of capsules, with derivatives by JAX. The
filter is relaxed, as in the example, and knows neither accelerations nor how obstacles move.
"""

from __future__ import annotations

from collections.abc import Sequence
import os

# As cbfpy recommends; JAX reads these as it starts.
os.environ.setdefault('XLA_FLAGS', '--xla_cpu_multi_thread_eigen=false')
os.environ.setdefault('JAX_ENABLE_X64', 'True')
os.environ.setdefault('JAX_PLATFORMS', 'cpu')
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

from cbfpy import CBF, CBFConfig
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from benchmark.peers.arm import in_joint
from benchmark.peers.jax_distances import capsule_gap, to_shapes
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

jax.config.update('jax_enable_x64', True)

_GAIN = 10.0  # of the barriers [1/s]


class CbfPy:
    """The filter; see the module."""

    def __init__(
        self, robot: Robot, obstacles: Sequence[Obstacle], margin: float, self_margin: float,
    ) -> None:
        """Compile the filter for these obstacles; margins to them and between links in [m]."""
        self.move(obstacles)
        config = _Config(robot, obstacles, margin, self_margin, self._places)
        cbf, rows = CBF.from_config(config), jnp.array(robot.rows)

        def filtered(q, position, rotation, dt, centers, rotations):  # type: ignore
            at, turned, jacobian = config.tip(q)
            error = jnp.concatenate((position - at, 0.5 * jnp.cross(
                turned.T, rotation.T).sum(axis=0)))
            nominal = jnp.linalg.pinv(jacobian[rows]) @ error[rows] / dt
            return cbf.safety_filter(q, nominal, centers, rotations)

        self._filtered = jax.jit(filtered)
        self.step(np.zeros(robot.n), Pose(np.zeros(3), np.eye(3)), 1.0)  # compiles it

    def step(self, q: Array, target: Pose, dt: float) -> Array:
        """See `Peer`."""
        dq = np.array(self._filtered(q, target.position, target.rotation, dt, *self._places))
        return dq if np.isfinite(dq).all() else np.zeros(len(q))

    def move(self, obstacles: Sequence[Obstacle]) -> None:
        """See `Peer`."""
        self._places = (np.array([o.center for o in obstacles]).reshape(-1, 3),
                        np.array([o.rotation for o in obstacles]).reshape(-1, 3, 3))


class _Config(CBFConfig):
    """Joint velocities as the input, positions as the state, and a barrier for each pair."""

    def __init__(
        self, robot: Robot, obstacles: Sequence[Obstacle], margin: float, self_margin: float,
        places: tuple[Array, Array],
    ) -> None:
        model = robot.model
        placements = [model.jointPlacements[i + 1] for i in range(robot.n)]
        self._fixed = [(jnp.array(p.rotation), jnp.array(p.translation)) for p in placements]
        self._axes = [np.array(model.joints[i + 1].createData().S).reshape(6)
                      for i in range(robot.n)]
        tip = model.frames[model.getFrameId(robot.tip_frame)].placement
        self._tip = jnp.array(tip.rotation), jnp.array(tip.translation)
        self._capsules = [in_joint(robot, capsule) for capsule in robot.capsules]
        self._radii = jnp.array([max(c.radius, 1e-5) for c in robot.capsules])
        self._moved = np.flatnonzero(robot.moved)
        self._kinds = [(o.shape, tuple(o.half_extents.tolist())) for o in obstacles]
        self._pairs = robot.self_pairs
        self._margins = margin, self_margin
        low, high = robot.position_min, robot.position_max
        self._limited = np.flatnonzero(np.isfinite(low) & np.isfinite(high))
        self._low, self._high = jnp.array(low), jnp.array(high)
        self._rows = jnp.array(robot.rows)
        self._count = robot.n
        super().__init__(n=robot.n, m=robot.n, u_min=-robot.velocity_max,
                         u_max=robot.velocity_max, init_args=places)

    def f(self, z, *args):  # type: ignore
        """No drift."""
        return jnp.zeros(self._count)

    def g(self, z, *args):  # type: ignore
        """The input is the velocity."""
        return jnp.eye(self._count)

    def h_1(self, z, centers, rotations):  # type: ignore
        """Return what is left to joint limits, between links and to obstacles."""
        starts, ends = self._segments(z)
        limits = self._limited
        left = [self._high[limits] - z[limits], z[limits] - self._low[limits]]
        if len(self._pairs):
            one, other = self._pairs[:, 0], self._pairs[:, 1]
            left.append(capsule_gap(starts[one], ends[one], starts[other], ends[other])
                        - self._radii[one] - self._radii[other] - self._margins[1])
        if self._kinds:
            moved = self._moved
            gaps = to_shapes(starts[moved], ends[moved], self._kinds, centers, rotations)
            left.append((gaps - self._radii[None, moved] - self._margins[0]).ravel())
        return jnp.concatenate(left)

    def alpha(self, h, *args):  # type: ignore
        """Return how fast a barrier may fall."""
        return _GAIN * h

    def P(self, z, u_des, *args):  # type: ignore  # noqa: N802 - the library's name
        """Return the weights: changes of the tip's velocity and of the null space's alike."""
        jacobian = self.tip(z)[2][self._rows]
        null = jnp.eye(self._count) - jnp.linalg.pinv(jacobian) @ jacobian
        return null.T @ null + jacobian.T @ jacobian

    def q(self, z, u_des, *args):  # type: ignore
        """Return the linear term, which has its least at the nominal velocity."""
        return -u_des.T @ self.P(z, u_des)

    def _joints(self, q):  # type: ignore
        """Return rotation, origin and axis of each joint's frame in the base."""
        rotation, origin, found = jnp.eye(3), jnp.zeros(3), []
        for i, (turn, shift) in enumerate(self._fixed):
            origin, rotation = origin + rotation @ shift, rotation @ turn
            axis = self._axes[i]
            along, about = rotation @ axis[:3], rotation @ axis[3:]
            if np.any(axis[3:]):
                rotation = rotation @ _turned(axis[3:], q[i])
            origin = origin + along * q[i]
            found.append((rotation, origin, along, about))
        return found

    def tip(self, q):  # type: ignore
        """Return the tip's position (3,), rotation (3, 3) and Jacobian (6, n)."""
        joints = self._joints(q)
        rotation, origin = joints[-1][0], joints[-1][1]
        at = origin + rotation @ self._tip[1]
        columns = [jnp.concatenate((along + jnp.cross(about, at - place), about))
                   for _, place, along, about in joints]
        return at, rotation @ self._tip[0], jnp.stack(columns, axis=1)

    def _segments(self, q):  # type: ignore
        """Return both ends (c, 3) of the capsules' segments."""
        joints = [(jnp.eye(3), jnp.zeros(3)), *(joint[:2] for joint in self._joints(q))]
        ends = [[joints[i][1] + joints[i][0] @ end for end in pair]
                for i, *pair in self._capsules]
        return (jnp.stack([start for start, _ in ends]), jnp.stack([end for _, end in ends]))


def _turned(axis: Array, angle):  # type: ignore
    """Return the rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = jnp.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return jnp.eye(3) + jnp.sin(angle) * cross + (1.0 - jnp.cos(angle)) * cross @ cross

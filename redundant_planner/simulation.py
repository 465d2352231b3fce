"""A motion offline: the planner's core in closed loop with an ideal arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.preview import TwistAhead
from redundant_planner.core.obstacles.clearance import Scene
from redundant_planner.core.planner import Planner
from redundant_planner.core.step_result import StepResult
from redundant_planner.paper.method import PaperPlanner

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """A simulated motion.

    Attributes:
        times: (k + 1,) [s].
        positions: (k + 1, n) [rad, m].
        velocities: (k, n) held from one time to the next [rad/s, m/s].
        results: of the k ticks.
    """

    times: Array
    positions: Array
    velocities: Array
    results: tuple[StepResult, ...]


def simulate(
    planner: Planner | PaperPlanner, start: Array, twist_at: Callable[[float], Array],
    scene: Scene, duration: float, dt: float, preview: TwistAhead | None = None,
) -> Motion:
    """Run the planner from rest at `start` for `duration`, one tick per `dt` [s].

    Args:
        planner: is reset first.
        start: (n,) [rad, m].
        twist_at: time [s] → twist (6,).
        scene: the obstacles.
        duration: [s].
        dt: [s].
        preview: what the variational method is told, times (N + 1,) [s] → mean twists (N, 6)
            from each to the next; nothing if None.
    """
    planner.reset()
    count = round(duration / dt)
    positions = np.empty((count + 1, len(start)))
    positions[0] = start
    results = []
    for i in range(count):
        ahead = None if preview is None else _from(preview, i * dt)
        result = planner.step(positions[i], twist_at(i * dt), scene, dt, ahead)
        positions[i + 1] = positions[i] + dt * result.dq
        results.append(result)
    times: Array = np.linspace(0.0, count * dt, count + 1, dtype=np.float64)
    return Motion(times, positions,
                  np.array([r.dq for r in results]), tuple(results))


def _from(preview: TwistAhead, now: float) -> TwistAhead:
    return lambda times: preview(now + times)

"""What a run came to: judged by coal with the exact shapes and the collision meshes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmark.bodies import capsules_of, meshes_of
from benchmark.closest_approach import Approach, Motion
from benchmark.judge import limit_violation
from benchmark.problem_sets.problem import Problem
from benchmark.problem_sets.servo import DT, Run
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# An arm this slow stands [rad/s].
_STANDSTILL = 1e-3


@dataclass(frozen=True)
class Outcome:
    """One method on one problem.

    Attributes:
        problem, family: names.
        reached: whether the tip came to the goal.
        mesh, capsule: the nearest that collision meshes and capsules came to an obstacle.
        itself: the nearest that two links' collision meshes came to each other.
        limit_violation: largest excess over a limit of position, velocity or acceleration, as a
            share of it (positions: in rad, m).
        path: Σ|Δq| over all joints [rad, m].
        l2: the same by the Euclidean length of each step.
        time: from the first motion to the end of the run [s].
        tick_us: (k,) time of every tick [us].
        reason: what held the arm back last.
        thought: time until the first motion [s].
        path_ratio: see `shortest.path_ratio`; NaN if nobody looked.
        time_ratio: of `time` to that of the fastest motion on the same path, see
            `fastest.fastest_time`; NaN if nobody looked.
    """

    problem: str
    family: str
    reached: bool
    mesh: Approach
    capsule: Approach
    itself: Approach
    limit_violation: float
    path: float
    l2: float
    time: float
    tick_us: Array
    reason: str
    thought: float = 0.0
    path_ratio: float = np.nan
    time_ratio: float = np.nan

    @property
    def cpu(self) -> float:
        """CPU time of all ticks [s]."""
        return 1e-6 * float(self.tick_us.sum())


class Judge:
    """Judges runs of one arm, at every tick."""

    def __init__(self, robot: Robot, urdf: Path) -> None:
        """Prepare its shapes; the URDF is the file that it was read from."""
        self._robot = robot
        self.capsules, self._meshes = capsules_of(robot), meshes_of(robot, urdf)

    def judge(self, problem: Problem, run: Run) -> Outcome:
        """Return what a run came to."""
        steps, thought = np.diff(run.postures, axis=0), DT * _first_motion(run.velocities)
        meshes = Motion.through(self._meshes, run.postures)
        capsules = Motion.through(self.capsules, run.postures)
        return Outcome(
            problem.name, problem.family, run.reached,
            meshes.to_obstacles(problem.obstacles, DT),
            capsules.to_obstacles(problem.obstacles, DT), meshes.to_itself(),
            limit_violation(self._robot, run.postures, run.velocities, DT),
            float(np.abs(steps).sum()), float(np.linalg.norm(steps, axis=1).sum()),
            DT * len(run.velocities) - thought, run.tick_us, run.reason, thought)


def _first_motion(velocities: Array) -> int:
    """Return how many ticks the arm stood first."""
    moves = np.abs(velocities).max(axis=1, initial=0.0) > _STANDSTILL
    return int(moves.argmax()) if moves.any() else len(moves)


def summarise(outcomes: Sequence[Outcome], left_out: Counter[str]) -> dict[str, Any]:
    """Return the JSON entry of one method.

    Args:
        outcomes: of its runs.
        left_out: why problems were left out → how many.
    """
    families = list(dict.fromkeys(o.family for o in outcomes))
    return {
        **_figures(outcomes),
        'left_out': dict(left_out),
        'by_family': {family: _figures([o for o in outcomes if o.family == family])
                      for family in families},
        'stopped': {o.problem: o.reason for o in outcomes if not o.reached},
        'notable': [_notable(o) for o in outcomes if collided(o) or o.limit_violation > 0.0],
    }


def collided(outcome: Outcome) -> bool:
    """Return whether the arm ran into an obstacle or itself."""
    return min(outcome.mesh.distance, outcome.itself.distance) < 0.0


def _figures(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the figures; paths and times are those of the runs that reached their goals."""
    reached = [o for o in outcomes if o.reached]
    ticks = [o.tick_us for o in outcomes if len(o.tick_us)]
    ratios = [o.path_ratio for o in reached if np.isfinite(o.path_ratio)]
    times = [o.time_ratio for o in reached if np.isfinite(o.time_ratio)]
    thoughts = [o.thought for o in reached]
    return {
        'count': len(outcomes),
        'reached': len(reached) / len(outcomes) if outcomes else None,
        'collisions': sum(o.mesh.distance < 0.0 for o in outcomes),
        'self_collisions': sum(o.itself.distance < 0.0 for o in outcomes),
        'limit_violations': sum(o.limit_violation > 0.0 for o in outcomes),
        'path_median': _median([o.path for o in reached]),
        'l2_median': _median([o.l2 for o in reached]),
        'time_median': _median([o.time for o in reached]),
        'total_median': _median([o.thought + o.time for o in reached]),
        'cpu_median': _median([o.cpu for o in reached]),
        'tick_us_median': float(np.median(np.concatenate(ticks))) if ticks else None,
        'tick_us_p99': float(np.percentile(np.concatenate(ticks), 99)) if ticks else None,
        'tick_us_longest': float(max(tick.max() for tick in ticks)) if ticks else None,
        'thought_median': _median(thoughts),
        'thought_p90': _percentile_90(thoughts),
        'path_ratio_median': _median(ratios),
        'path_ratio_p90': _percentile_90(ratios),
        'time_ratio_median': _median(times),
        'time_ratio_p90': _percentile_90(times),
        'min_distance_mm': _least([o.mesh for o in outcomes]),
        'min_capsule_distance_mm': _least([o.capsule for o in outcomes]),
    }


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _percentile_90(values: Sequence[float]) -> float | None:
    return float(np.percentile(values, 90)) if values else None


def _least(approaches: Sequence[Approach]) -> float | None:
    least = min((a.distance for a in approaches), default=np.inf)
    return 1e3 * least if np.isfinite(least) else None


def _notable(outcome: Outcome) -> dict[str, Any]:
    return {
        'problem': outcome.problem, 'reached': outcome.reached,
        'limit_violation': outcome.limit_violation,
        **{name: f'{1e3 * a.distance:.2f} mm, {a} at {a.index * DT:.3f} s' for name, a in (
            ('mesh', outcome.mesh), ('capsule', outcome.capsule), ('itself', outcome.itself))
           if a.first},
    }

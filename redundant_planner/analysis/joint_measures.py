"""The paper's measures of every joint, added up while a bag is read."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from redundant_planner.io.joint_chunk import GAP

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class JointMeasures:
    """The paper's measures of every joint, (n,) each [rad, m; per s; per s²].

    Attributes:
        displacement: |q_end − q_start|.
        path: ∫|q̇| as Σ|Δq|, Eq. 10.
        effort: ∫q̇², each velocity held until the next sample.
        initial_velocity: |q̇(0)|.
        velocity_change: |q̇_end − q̇(0)|.
        acceleration_change: |q̈_end − q̈(0)|, by differences over one sample.
        peak_velocity, peak_acceleration: the largest.
    """

    displacement: Array
    path: Array
    effort: Array
    initial_velocity: Array
    velocity_change: Array
    acceleration_change: Array
    peak_velocity: Array
    peak_acceleration: Array


@dataclass
class JointSums:
    """Measures of n joints, added up chunk by chunk.

    Attributes:
        samples: joint states so far.
        backwards: steps back in time.
        gaps, longest_gap: pauses of more than `GAP`, and the longest [s].
        begin_time, end_time: of the first and the last joint state [s].
    """

    n: int
    samples: int = 0
    backwards: int = 0
    gaps: int = 0
    longest_gap: float = 0.0
    start: Array = field(default_factory=lambda: np.empty(0))
    start_velocity: Array = field(default_factory=lambda: np.empty(0))
    start_acceleration: Array | None = None
    end: Array = field(default_factory=lambda: np.empty(0))
    end_velocity: Array = field(default_factory=lambda: np.empty(0))
    end_acceleration: Array | None = None
    begin_time: float = 0.0
    end_time: float = 0.0
    path: Array = field(init=False)
    effort: Array = field(init=False)
    peak_velocity: Array = field(init=False)
    peak_acceleration: Array = field(init=False)

    def __post_init__(self) -> None:
        """Begin at zero."""
        self.path, self.effort, self.peak_velocity, self.peak_acceleration = np.zeros((4, self.n))

    def add(self, times: Array, q: Array, dq: Array) -> tuple[Array, Array]:
        """Add samples (k, n); return their velocities and accelerations (k, n)."""
        if self.samples:
            times = np.concatenate(((self.end_time,), times))
            q, dq = np.vstack((self.end, q)), np.vstack((self.end_velocity, dq))
        steps = np.diff(times)
        self.backwards += int((steps < 0.0).sum())
        gaps = steps[steps > GAP]
        self.gaps += len(gaps)
        self.longest_gap = max(self.longest_gap, float(gaps.max(initial=0.0)))
        # Of a step back, and of a gap, nobody knows how fast the arm was.
        positive = np.where(steps <= GAP, np.maximum(steps, 0.0), 0.0)[:, None]
        moves = np.diff(q, axis=0)
        with np.errstate(divide='ignore', invalid='ignore'):
            # Without measured velocities those between the samples.
            slopes = np.where(positive > 0.0, moves / positive, 0.0)
            if np.isnan(dq).any():
                first = slopes[:1] if len(slopes) else np.zeros((1, self.n))
                dq = np.where(np.isnan(dq), np.vstack((first, slopes)), dq)
            changes = np.where(positive > 0.0, np.diff(dq, axis=0) / positive, 0.0)
        if not self.samples:
            self.start, self.start_velocity, self.begin_time = q[0], dq[0], float(times[0])
        if self.start_acceleration is None and len(changes):
            self.start_acceleration = changes[0]
        self.path += np.abs(moves).sum(axis=0)
        self.effort += (dq[:-1] ** 2 * positive).sum(axis=0)
        self.peak_velocity = np.maximum(self.peak_velocity, np.abs(dq).max(axis=0))
        if len(changes):
            self.peak_acceleration = np.maximum(
                self.peak_acceleration, np.abs(changes).max(axis=0))
            self.end_acceleration = changes[-1]
        fresh = len(times) - (1 if self.samples else 0)
        self.samples += fresh
        self.end, self.end_velocity, self.end_time = q[-1], dq[-1], float(times[-1])
        accelerations = np.vstack((changes[:1] if len(changes) else np.zeros((1, self.n)),
                                   changes))
        return dq[-fresh:], accelerations[-fresh:]

    def measures(self) -> JointMeasures:
        """Return the measures of all that was added."""
        still = np.zeros(self.n)
        first = still if self.start_acceleration is None else self.start_acceleration
        last = still if self.end_acceleration is None else self.end_acceleration
        return JointMeasures(
            np.abs(self.end - self.start), self.path, self.effort,
            np.abs(self.start_velocity), np.abs(self.end_velocity - self.start_velocity),
            np.abs(last - first), self.peak_velocity, self.peak_acceleration)

"""What was found out about a bag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis import metrics
from redundant_planner.analysis.chunk_following import ChunkRun
from redundant_planner.analysis.commanded import CommandPeaks
from redundant_planner.analysis.joint_measures import JointMeasures
from redundant_planner.analysis.run_facts import RunFacts
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Curves:
    """The motion over time, thinned out to k samples.

    Attributes:
        times: (k,) [s].
        positions, velocities, accelerations: (k, n) measured; accelerations are differences
            between samples, noise and jitter included.
        commanded: velocities and accelerations (k, n) of the command that held then, NaN where
            none did; None without commands.
        clearance: (k,) smallest distance of a link to an obstacle, not more than the true one,
            the smallest since the sample before [m]; infinite without robot or obstacles.
        scale: (k,) share of the commanded twist that the tip followed, NaN without a command
            and while it is below a hundredth of the largest.
        tips: (k, 3) in the base frame [m], NaN without a robot.
        path_error: (k,) distance of the tip from the path that twists command, NaN while none do,
            as on the way to a target [m].
        scenes: times [s] from which on the obstacles stood as given.
    """

    times: Array
    positions: Array
    velocities: Array
    accelerations: Array
    commanded: tuple[Array, Array] | None
    clearance: Array
    scale: Array
    tips: Array
    path_error: Array
    scenes: tuple[tuple[float, Scene], ...]


@dataclass(frozen=True)
class Analysis:
    """What was found out about a bag.

    Attributes:
        name: of the bag.
        robot: of the bag, None if nothing said which.
        joint_names: n names.
        samples: of joint states.
        begin, end: of the motion, from the bag's first message [s].
        joints: measures per joint, of the measured motion.
        commanded: the commands' peaks, None without commands.
        curves: over time.
        clearance: the smallest level and where it was, None without robot or obstacles.
        distance: the smallest distance [m].
        periods: of joint_command, None without commands.
        factor: of `/diagnostics`, (k, 2) time and k; empty if none were recorded.
        notes: what is missing, and what could not be read.
        facts: how the motion came about.
        chunks: how the arm followed chunks, and what the planner said where it was furthest off.
    """

    name: str
    robot: Robot | None
    joint_names: tuple[str, ...]
    samples: int
    begin: float
    end: float
    joints: JointMeasures
    commanded: CommandPeaks | None
    curves: Curves
    clearance: metrics.Clearance | None
    distance: float
    periods: metrics.Periods | None
    factor: Array
    notes: tuple[str, ...]
    facts: RunFacts
    chunks: tuple[tuple[ChunkRun, str], ...] = ()


def scene_at(curves: Curves, time: float) -> Scene:
    """Return the obstacles as they stood at a time [s], as a scene."""
    scene = curves.scenes[0][1]
    for begin, candidate in curves.scenes:
        if begin > time:
            break
        scene = candidate
    return scene

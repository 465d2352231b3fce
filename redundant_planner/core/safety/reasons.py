"""What slows or stops the arm, and which bounds on its work the filter reached, in words."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.nearby import Surroundings
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.safety.barriers import (
    Barriers,
    CONE,
    LINK,
    OBSTACLE,
    OWN,
    OWN_AT_REST,
    SELF_MOTION,
    SINGULARITY,
)
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.safety.stages import Filtered
from redundant_planner.core.safety.way_out import LastWayOut

Array = npt.NDArray[np.float64]

# The drives' own way to speed up and to stop.
_HARMLESS = (Stage.DESIRED, Stage.SCALED, Stage.BRAKING)
# What is said of an arm that J's smallest singular value holds back; the second without a row.
_SINGULAR = ('near a singularity', 'singular posture')


def reason_for(
    result: Filtered, barriers: Barriers, around: Surroundings, robot: Robot,
    largest_change: Array, q: Array, last_way_out: LastWayOut, own: Sequence[str] = (), *,
    commanded: bool, course: str,
) -> str:
    """Say what holds the arm back; empty where nothing but its drives does.

    Args:
        result: what the filter decided.
        barriers, around: of the tick, and the obstacles that they are about.
        robot: the arm.
        largest_change: (n,) share of the acceleration limit that each joint used, 1 at most.
        q: (n,) the posture.
        last_way_out: which way leads out of a singularity.
        own: names of the user's barriers.
        commanded: whether any motion is.
        course: what the arm leaves its path for before it is near; empty if it does not.
    """
    if (result.scale > 0.99 or not commanded) and result.stage in _HARMLESS:
        return ''
    at_limit = [i for i in result.joints.tolist() if largest_change[i] < 1.0 - 1e-6]
    if len(result.joints) and not at_limit and not len(result.pairs) and not course:
        # It is speeding up.
        return ''
    names = [f"joint '{robot.joint_names[i]}' at its limit" for i in at_limit]
    names += [_row_name(row, barriers, around, robot, own) for row in result.pairs.tolist()]
    names = names or [course or _SINGULAR[1]]
    # A link may have several points near an obstacle.
    named = ', '.join(name + last_way_out.words(q) if name in _SINGULAR else name
                      for name in dict.fromkeys(names))
    return f'{result.stage.value}: {named}'


def fallbacks_of(result: Filtered, unseen_share: float) -> list[str]:
    """Say which bounds on its work the filter reached, and what was done instead.

    Args:
        result: what it decided.
        unseen_share: of the fastest motion, for obstacles that a tick does not look at.
    """
    said = [f'out of iterations where {stage.value}' for stage in result.cut_short]
    if unseen_share < 1.0:
        said.append('slower among more obstacles than a tick takes in: '
                    f'{math.floor(100.0 * unseen_share)}% of the speed')
    return said


def _row_name(
    row: int, barriers: Barriers, around: Surroundings, robot: Robot, own: Sequence[str],
) -> str:
    """Name a barrier as a sentence's part."""
    kind = int(barriers.kind[row])
    if kind == SINGULARITY:
        return _SINGULAR[0]
    if kind in (OWN, OWN_AT_REST):
        return f"'{own[int(barriers.first[row])]}'"
    if kind == CONE:
        return 'the tip leans as far as cone.angle lets it'
    if kind == SELF_MOTION:
        return 'null-space motion that could not stop without leaving the path'
    link = robot.capsules[int(barriers.first[row])].name
    other = int(barriers.second[row])
    if kind == LINK:
        return f"link '{link}' near link '{robot.capsules[other].name}'"
    index = around.near if kind == OBSTACLE else around.nearest
    return f"link '{link}' near obstacle '{around.scene.names[index[other]]}'"

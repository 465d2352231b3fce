"""What one tick decided."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.target.progress import Progress

Array = npt.NDArray[np.float64]


class Nearest(NamedTuple):
    """The link and obstacle with the smallest level value.

    Attributes:
        link, obstacle: their names.
        level: S of Eq. 6 over the whole link, 0 at the safety margin and at the distance kept
            from an obstacle for its motion.
        beyond_margin: how much further apart than the margin they are, at least [m]; negative
            within it. `PaperPlanner` keeps no margin: its distance.
    """

    link: str
    obstacle: str
    level: float
    beyond_margin: float


class TipResult(NamedTuple):
    """What one tick decided about one of several tips.

    Attributes:
        pose, path_error, scale: of this tip, as in `StepResult`.
    """

    pose: Pose
    path_error: Array
    scale: float


class OwnValue(NamedTuple):
    """What a barrier or criterion of the user's own came to in a tick.

    Attributes:
        name: its name.
        value: h or H at the posture that the tick starts from; NaN where it is no finite number.
    """

    name: str
    value: float


class StepResult(NamedTuple):
    """What one tick decided; arrays are the caller's to keep.

    Attributes:
        dq: (n,) joint velocity command [rad/s, m/s].
        least_norm: (n,) J⁺ẋ of this tick.
        homogeneous: (n,) k P∇H of this tick, or the null-space part of the joint path ahead.
        factor: k of Eq. 1; 1 where a joint path ahead gives all null-space motion.
        scale: s, the share of the commanded twist that is followed.
        stage: how the safety filter came to `dq`.
        reason: one sentence: what slows or stops the arm; empty when nothing does.
        fallback: which bound on a tick's work was reached, and what was done instead; empty if
            none was. It is part of the reason.
        clearance_index: H_w over all pairs within the influence distance; infinite without any.
        nearest: the nearest pair, None without obstacles. Of many obstacles that are all too far
            away to matter, it may be another than the nearest.
        manipulability: Yoshikawa's measure, the product of J's singular values.
        pose: the tip at the posture that the tick starts from: where the commands before it take
            the arm.
        path_error: (6,) reference pose minus `pose` before this tick, in command axes [m, rad].
        jerk_kept: whether the jerk limits hold; where something moves in, they give way.
        progress: towards the target, None without one.
        tips: of an arm with several tips, what was decided about each; empty with one. `pose` and
            `path_error` are the first tip's then, and `scale` the least.
        own: the user's own barriers, then their own criteria; empty without any.
    """

    dq: Array
    least_norm: Array
    homogeneous: Array
    factor: float
    scale: float
    stage: Stage
    reason: str
    fallback: str
    clearance_index: float
    nearest: Nearest | None
    manipulability: float
    pose: Pose
    path_error: Array
    jerk_kept: bool = True
    progress: Progress | None = None
    tips: tuple[TipResult, ...] = ()
    own: tuple[OwnValue, ...] = ()

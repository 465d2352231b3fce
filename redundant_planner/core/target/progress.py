"""How far a motion to a target has come."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

# A target is reached this near to it [m, rad].
REACHED = 2e-4


class TargetState(Enum):
    """What the arm does about its target."""

    THINKING = 'thinking'
    MOVING = 'moving'
    REACHED = 'reached'
    BLOCKED = 'blocked'
    OUT_OF_REACH = 'out of reach'


class Progress(NamedTuple):
    """How far a motion to a target has come.

    Attributes:
        state: what the arm does.
        distance: of the tip from the target [m].
        angle: of the rotation that is left [rad].
        seconds: until it is there if nothing gets in the way [s].
        miss: how near its way comes to the target: 0 if it leads there [m, rad].
        joint: what the joint that is furthest from a target of the joints is off by; 0 on the way
            to a pose [rad, m].
        behind: how far the arm is behind the time of a chunk [s].
        beside: how far from the chunk it is at that time: the joint or the axis of the tip that
            is furthest off [rad, m].
    """

    state: TargetState
    distance: float
    angle: float
    seconds: float
    miss: float
    joint: float = 0.0
    behind: float = 0.0
    beside: float = 0.0

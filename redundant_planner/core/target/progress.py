"""How far a motion to a target has come."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


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
    """

    state: TargetState
    distance: float
    angle: float
    seconds: float
    miss: float

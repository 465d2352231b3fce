"""How the safety filter came to a velocity; a file of its own, to be had without machine code."""

from __future__ import annotations

from enum import Enum


class Stage(Enum):
    """Which problem gave the velocity, in the order in which they are tried."""

    DESIRED = 'the desired velocity breaks no limit'
    SCALED = 'the speed gave way'
    SLIDING = 'the tip slides along what is in its way'
    BRAKING = 'the arm brakes'
    YIELDING = 'the arm leaves its path to evade'
    FORCED = "the arm's limits leave too little time to keep a clearance in full"
    STOPPED = 'no problem had a solution: every joint slows down as fast as it may'

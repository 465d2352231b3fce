"""Motions as headsets and policies send them: a circle, an eight, a hand, or joints that swing.

A hand makes minimum-jerk submovements with tremor (Flash and Hogan 1985).
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import integrate, Pose

Array = npt.NDArray[np.float64]
Signal = Callable[[float], Pose | Array]

# How long a motion takes to set off, and how long it is measured [s].
BEGINS, LASTS = 1.0, 10.0
# A circle and an eight [m], [1/s], and how far the hand turns meanwhile [rad].
RADIUS, _FREQUENCY, _TURN = 0.1, 0.4, 0.2
# A hand: how far its submovements lead [m, rad], how long they take [s], and its tremor [m, 1/s].
_REACH, _REACH_ANGLE, _SHORT, _LONG = 0.1, 0.3, 0.5, 1.2
_TREMOR, _TREMOR_FREQUENCY = 2e-4, 9.0
# Joints: how far [rad] and how often [1/s].
_SWING, _SWINGS = 0.2, 0.2
# Every so often a frame is wrong by so much, or the sender is silent for so long [s], [m], [s].
_EVERY, _WRONG, _SILENT = 2.0, 0.2, 0.15
_NOISE, _ANGLE_NOISE = 1e-3, 1e-3


class Input(NamedTuple):
    """How a motion is sent.

    Attributes:
        rate: of its messages [Hz].
        noise: whether each is off by a millimetre and a milliradian (standard deviation).
        burst: they come together once in so long [s].
        wrong: whether a frame is 20 cm off now and then.
        gaps: whether some are missing now and then.
        stamped: whether they say when they are of.
        joints: whether they are joint positions.
    """

    rate: float
    noise: bool = False
    burst: float = 0.0
    wrong: bool = False
    gaps: bool = False
    stamped: bool = False
    joints: bool = False


INPUTS = {
    **{f'{rate} Hz': Input(rate) for rate in (500, 250, 72, 30, 10, 5, 3)},
    '72 Hz noise': Input(72, noise=True), '30 Hz noise': Input(30, noise=True),
    '72 Hz bursts 0.1 s': Input(72, burst=0.1, stamped=True),
    '72 Hz bursts 0.2 s': Input(72, burst=0.2, stamped=True),
    '72 Hz bursts 0.2 s unstamped': Input(72, burst=0.2),
    '72 Hz outliers': Input(72, wrong=True), '30 Hz outliers': Input(30, wrong=True),
    '72 Hz gaps': Input(72, gaps=True),
    'joints 72 Hz': Input(72, joints=True), 'joints 30 Hz': Input(30, joints=True),
    'joints 10 Hz': Input(10, joints=True),
}


class Message(NamedTuple):
    """A target, when it is of and when it comes [s]."""

    target: Pose | Array
    stamp: float
    arrival: float

def _eased(t: float) -> float:
    """Return a time that begins gently: its rate rises from 0 to 1 within `BEGINS`."""
    x = min(t / BEGINS, 1.0)
    return BEGINS * (x**3 - 0.5 * x**4) + max(t - BEGINS, 0.0)


def _minimum_jerk(x: float) -> float:
    return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


def motion(robot: Robot, start: Array, seed: int, *, joints: bool) -> Signal:
    """Return the motion of a seed, which begins at a posture (n,)."""
    random = np.random.default_rng([seed, 5])
    if joints:
        swing = _SWING * random.uniform(0.5, 1.0, robot.n)
        phases = random.uniform(0.0, 2.0 * math.pi, robot.n)

        def sine(t: float) -> Array:
            angle = 2.0 * math.pi * _SWINGS * _eased(t)
            return np.asarray(start + swing * (np.sin(angle + phases) - np.sin(phases)))
        return sine
    arm = robot.kinematics(start)
    here = Pose(arm.tip_position, arm.tip_rotation)
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
    turn = axes @ random.normal(size=3)
    turn *= _TURN / np.linalg.norm(turn)

    def displaced(away: Array, angle: Array) -> Pose:
        return integrate(here, np.concatenate((axes @ away, angle)), 1.0, False)
    if seed % 3 < 2:
        def curve(t: float) -> Pose:
            angle = 2.0 * math.pi * _FREQUENCY * _eased(t)
            sine, cosine = math.sin(angle), math.cos(angle)
            away = (cosine - 1.0, sine, 0.0) if seed % 3 == 0 else (sine, sine * cosine, 0.0)
            return displaced(RADIUS * np.array(away), math.sin(0.5 * angle) * turn)
        return curve
    lengths = np.cumsum(random.uniform(_SHORT, _LONG, 40))
    places = np.vstack((np.zeros(6), random.uniform(-1.0, 1.0, (40, 6)) * np.repeat(
        (_REACH, _REACH_ANGLE), 3)))

    def hand(t: float) -> Pose:
        i = int(np.searchsorted(lengths, t))
        begin = lengths[i - 1] if i else 0.0
        share = _minimum_jerk((t - begin) / (lengths[i] - begin))
        place = places[i] + share * (places[i + 1] - places[i])
        tremor = _TREMOR * _eased(t) / (1.0 + t) * np.sin(
            2.0 * math.pi * _TREMOR_FREQUENCY * t + np.array((0.0, 2.0, 4.0)))
        return displaced(place[:3] + tremor, place[3:])
    return hand


def messages(signal: Signal, given: Input, seed: int) -> list[Message]:
    """Return what is sent of a motion, in the order in which it comes."""
    random = np.random.default_rng([seed, 6])
    found = []
    every = round(_EVERY * given.rate)
    for i in range(int((BEGINS + LASTS) * given.rate) + 1):
        stamp = i / given.rate
        target = signal(stamp)
        if given.gaps and i % every > every - _SILENT * given.rate:
            continue
        if isinstance(target, Pose):
            off = np.concatenate((random.normal(size=3) * _NOISE,
                                  random.normal(size=3) * _ANGLE_NOISE)) * given.noise
            if given.wrong and i % every == every - 1:
                off[:3] += _WRONG * random.choice((-1.0, 1.0)) * np.eye(3)[i % 3]
            target = integrate(target, off, 1.0, False)
        arrival = math.ceil(stamp / given.burst - 1e-9) * given.burst if given.burst else stamp
        found.append(Message(target, stamp, arrival))
    return found

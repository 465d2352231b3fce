"""Reads a serialised MultiDOFJointTrajectory, the twists ahead, straight into arrays.

rclpy takes 20 µs to make Python objects of a point; a long preview would hold the loop up.
"""

from __future__ import annotations

import numpy as np

from redundant_planner.core.errors import StateError
from redundant_planner.core.horizon.preview import Preview
from redundant_planner.core.kernels import compiled, Indices
from redundant_planner.io.cdr import byte_order, header_of, signed, words_and_doubles
from redundant_planner.io.joint_layout import MOST_JOINTS
from redundant_planner.io.plausible import FASTEST

# Points that a preview may have: 50 s at 1 kHz.
MOST_POINTS = 50_000

# What the walk finds of a point, in words of the payload: the number of velocities, and where the
# first of them and the time are.
_COUNT, _TWIST, _TIME = range(3)


def read_preview(raw: bytes) -> tuple[float, Preview]:
    """Return the stamp [s], 0 for none, and the twists ahead.

    Every point has its time and one velocity, of the tip.

    Raises:
        StateError: the bytes are no such message, a point has no or several velocities, or the
            numbers make no preview.
    """
    order = byte_order(raw)
    stamp, _, at = header_of(raw, order)
    words, doubles = words_and_doubles(raw, order)
    begin, count = _points(words, -(-at // 4))
    if begin < 0:
        raise StateError('the bytes are no MultiDOFJointTrajectory: they end before the points')
    if count > MOST_POINTS:
        raise StateError(f'the preview has {count} points; up to {MOST_POINTS} are read')
    found = _walk(words, begin, count)
    other = found[:, _COUNT] != 1
    if other.any():
        i = int(other.argmax())
        raise StateError(f'point {i} of the preview has {found[i, _COUNT]} velocities; it takes '
                         'one, of the tip')
    if len(found) < count:
        raise StateError(f'the bytes end within point {len(found)} of {count} of the preview')
    twists = doubles[found[:, _TWIST, None] // 2 + np.arange(6)]
    far = ~(np.abs(twists) <= FASTEST).all(axis=1)
    if far.any():
        i = int(far.argmax())
        raise StateError(f'the twist of point {i} of the preview is {twists[i].tolist()}; all six '
                         f'entries must be finite, up to {FASTEST:g} m/s and rad/s')
    times = found[:, _TIME]
    return stamp, Preview(signed(words[times]) + 1e-9 * words[times + 1], twists)


@compiled
def _points(words: Indices, at: int) -> tuple[int, int]:
    """Return where the points begin, −1 if nowhere, and how many there are.

    Args:
        words: of the payload.
        at: where the number of joint names stands.
    """
    end = len(words)
    if at >= end or words[at] > MOST_JOINTS:
        return -1, 0
    names = words[at]
    at += 1
    for _ in range(names):
        if at >= end:
            return -1, 0
        at += 1 + (words[at] + 3) // 4
    if at >= end:
        return -1, 0
    return at + 1, words[at]


@compiled
def _walk(words: Indices, at: int, count: int) -> Indices:
    """Return what lies where in the points (k, 3), up to the first that the payload ends within.

    Args:
        words: of the payload.
        at: where the points begin.
        count: of points.
    """
    found = np.empty((count, 3), np.intp)
    end = len(words)
    for i in range(count):
        # Transforms, velocities and accelerations.
        for field, size in enumerate((14, 12, 12)):
            if at >= end:
                return found[:i]
            entries = words[at]
            at += 1
            if entries:
                at += at % 2
            if field == 1:
                found[i, _COUNT], found[i, _TWIST] = entries, at
            at += entries * size
        found[i, _TIME] = at
        at += 2
        if at > end:
            return found[:i]
    return found

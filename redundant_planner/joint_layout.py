"""Where the numbers lie in a serialised sensor_msgs/JointState.

Successive messages of one publisher differ in stamp and numbers alone: whoever knows the layout of
the first reads and writes the others without making a message of them, which takes rclpy 50 µs.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

# Bytes of the encapsulation, which alignment does not count, and of it and the stamp.
_ENCAPSULATION = 4
STAMP = _ENCAPSULATION
AFTER_STAMP = STAMP + 8


class LayoutError(ValueError):
    """The bytes are no JointState, or its lists differ in length."""


class JointLayout(NamedTuple):
    """The layout of a message.

    Attributes:
        names: of the joints.
        positions, velocities: offsets of the first position and velocity, 0 where there are none.
        order: of the bytes, as struct and NumPy call it: '<' or '>'.
    """

    names: tuple[str, ...]
    positions: int
    velocities: int
    order: str


def joint_layout(raw: bytes) -> JointLayout:
    """Return the layout of a CDR-serialised JointState.

    Raises:
        LayoutError: there is none to read, or positions are missing.
    """
    try:
        return _layout(raw)
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise LayoutError(f'it is no JointState: {error}') from None


def _layout(raw: bytes) -> JointLayout:
    order = '<' if raw[1] & 1 else '>'

    def aligned(at: int, size: int) -> int:
        return _ENCAPSULATION + -(-(at - _ENCAPSULATION) // size) * size

    def count(at: int) -> tuple[int, int]:
        at = aligned(at, 4)
        return int(struct.unpack_from(order + 'I', raw, at)[0]), at + 4

    length, at = count(AFTER_STAMP)
    number, at = count(at + length)
    if number > len(raw):
        raise LayoutError('it is no JointState')
    names = []
    for _ in range(number):
        length, at = count(at)
        names.append(bytes(raw[at:at + length - 1]).decode())
        at += length
    offsets = []
    for field in ('position', 'velocity'):
        values, at = count(at)
        if values not in (0, number) or (field == 'position' and values != number):
            raise LayoutError(f'{number} joint names came with {values} {field} values')
        at = aligned(at, 8) if values else at
        offsets.append(at if values else 0)
        at += 8 * values
        if at > len(raw):
            raise LayoutError('it ends too early')
    return JointLayout(tuple(names), offsets[0], offsets[1], order)

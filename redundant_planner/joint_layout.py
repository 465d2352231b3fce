"""Where the numbers lie in a serialised sensor_msgs/JointState.

Successive messages of one publisher differ in stamp and numbers alone (and in the bytes between
fields, which hold anything): whoever knows the layout of the first reads and writes the others
without making a message of them, which takes rclpy 50 µs.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

_ENCAPSULATION = 4  # bytes before the payload, which alignment does not count
STAMP = _ENCAPSULATION


class LayoutError(ValueError):
    """The bytes are no JointState, or its lists differ in length."""


class JointLayout(NamedTuple):
    """The layout of a message.

    Attributes:
        names: of the joints.
        positions, velocities: offsets of the first position and velocity, 0 where there are none.
        order: of the bytes, as struct and NumPy call it: '<' or '>'.
        size: of the message.
        fixed: where the bytes lie that tell this layout, first and last each.
    """

    names: tuple[str, ...]
    positions: int
    velocities: int
    order: str
    size: int
    fixed: tuple[tuple[int, int], ...]

    def fits(self, one: bytes, other: bytes) -> bool:
        """Return whether a message has the layout of another one, whose layout this is."""
        return len(one) == self.size and all(
            one[begin:end] == other[begin:end] for begin, end in self.fixed)


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

    length, at = count(STAMP + 8)
    fixed = [(1, 2), (at - 4, at)]  # the order of bytes, and the length of frame_id
    number, at = count(at + length)
    fixed.append((at - 4, at))
    if number > len(raw):
        raise LayoutError('it is no JointState')
    names = []
    for _ in range(number):
        length, at = count(at)
        names.append(bytes(raw[at:at + length - 1]).decode())
        fixed.append((at - 4, at + length))
        at += length
    offsets = []
    for field in ('position', 'velocity'):
        values, at = count(at)
        fixed.append((at - 4, at))
        if values not in (0, number) or (field == 'position' and values != number):
            raise LayoutError(f'{number} joint names came with {values} {field} values')
        at = aligned(at, 8) if values else at
        offsets.append(at if values else 0)
        at += 8 * values
        if at > len(raw):
            raise LayoutError('it ends too early')
    return JointLayout(tuple(names), offsets[0], offsets[1], order, len(raw), tuple(fixed))

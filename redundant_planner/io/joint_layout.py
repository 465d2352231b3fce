"""Where the numbers lie in a serialised sensor_msgs/JointState.

Successive messages of one publisher differ in stamp and numbers alone (and in the bytes between
fields, which hold anything): whoever knows the layout of the first reads and writes the others
without making a message of them, which takes rclpy 50 µs.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from redundant_planner.core.errors import StateError
from redundant_planner.io.cdr import byte_order, ENCAPSULATION, text

STAMP = ENCAPSULATION
# Most joints that a message is read with: two arms with hands have some sixty.
MOST_JOINTS = 1000


class LayoutError(StateError):
    """The bytes are no JointState, or its lists differ in length.

    Attributes:
        names: of the joints, as far as they could be read.
    """

    def __init__(self, message: str, names: tuple[str, ...] = ()) -> None:
        """Say what is wrong with a message, and whose it is."""
        super().__init__(message)
        self.names = names


class JointLayout(NamedTuple):
    """The layout of a message.

    Attributes:
        names: of the joints.
        positions, velocities: offsets of the first position and velocity, 0 where there are none.
        order: of the bytes, as struct and NumPy call it: '<' or '>'.
        size: of the message.
        fixed: where the bytes lie that tell this layout, first and last each.
        efforts: offset of the first effort, 0 where there are none.
    """

    names: tuple[str, ...]
    positions: int
    velocities: int
    order: str
    size: int
    fixed: tuple[tuple[int, int], ...]
    efforts: int

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
    except LayoutError:
        raise
    except StateError as error:
        raise LayoutError(f'the bytes are no JointState: {error}') from None
    except struct.error:
        raise LayoutError('the bytes are no JointState: they end too early') from None


def _layout(raw: bytes) -> JointLayout:
    order = byte_order(raw)
    unsigned = struct.Struct(f'{order}I')

    def aligned(at: int, size: int) -> int:
        return ENCAPSULATION + -(-(at - ENCAPSULATION) // size) * size

    def count(at: int) -> tuple[int, int]:
        at = aligned(at, 4)
        return int(unsigned.unpack_from(raw, at)[0]), at + 4

    length, at = count(STAMP + 8)
    fixed = [(0, 2), (at - 4, at)]  # the order of bytes, and the length of frame_id
    number, at = count(at + length)
    fixed.append((at - 4, at))
    if number > MOST_JOINTS:
        raise LayoutError(f'it has {number} joint names; up to {MOST_JOINTS} are read')
    names = []
    for _ in range(number):
        length, at = count(at)
        names.append(text(raw, at, length))
        fixed.append((at - 4, at + length))
        at += length
    offsets = {}
    for field in ('position', 'velocity', 'effort'):
        values, at = count(at)
        fixed.append((at - 4, at))
        if field == 'position' and values != number:
            raise LayoutError(
                f'{number} joint names came with {values} {field} values', tuple(names))
        at = aligned(at, 8) if values else at
        offsets[field] = at if values == number > 0 else 0
        at += 8 * values
        if at > len(raw):
            raise LayoutError('the bytes are no JointState: they end too early')
    return JointLayout(tuple(names), offsets['position'], offsets['velocity'], order, len(raw),
                       tuple(fixed), offsets['effort'])

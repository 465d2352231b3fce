"""Reads a serialised sensor_msgs/PointCloud2: where its points lie, and their coordinates.

A cloud says itself how its bytes are laid out: any fields in any order, with gaps between points
and between rows, in either byte order. NumPy reads the coordinates through strides; nothing else
of the message is copied.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, StateError
from redundant_planner.io.cdr import byte_order, ENCAPSULATION, text

Array = npt.NDArray[np.float64]

# Points that a cloud may have: an image of 1920 × 1080 is one.
MOST_POINTS = 2**21
_MOST_FIELDS = 1000
_NANOSECONDS = 1_000_000_000
# sensor_msgs/PointField's numbers; those that coordinates may have, as NumPy calls them.
_DATATYPES = {1: 'INT8', 2: 'UINT8', 3: 'INT16', 4: 'UINT16', 5: 'INT32', 6: 'UINT32',
              7: 'FLOAT32', 8: 'FLOAT64'}
FLOAT32, FLOAT64 = 7, 8
_NUMBERS = {FLOAT32: 'f4', FLOAT64: 'f8'}
_AXES = ('x', 'y', 'z')


class CloudError(StateError):
    """The bytes are no PointCloud2 that can be used; the message says why."""


class CloudLayout(NamedTuple):
    """What a cloud says about its bytes.

    Attributes:
        stamp_ns: of the header, 0 where there is none [ns].
        frame: in which the points are given.
        height, width: rows, and points in each; an unorganised cloud has one row.
        offsets: of x, y and z in a point [bytes].
        kinds: of x, y and z as NumPy calls them, with their byte order.
        point_step, row_step: from one point and one row to the next [bytes].
        begin: where the first point lies in the message [bytes].
    """

    stamp_ns: int
    frame: str
    height: int
    width: int
    offsets: tuple[int, ...]
    kinds: tuple[str, ...]
    point_step: int
    row_step: int
    begin: int


class _Field(NamedTuple):
    """A field of a cloud's points; numbers is what sensor_msgs/PointField calls count."""

    offset: int
    datatype: int
    numbers: int


def cloud_layout(raw: bytes) -> CloudLayout:
    """Return the layout of a CDR-serialised PointCloud2.

    Raises:
        CloudError: the bytes are no PointCloud2, or their description contradicts itself.
    """
    try:
        return _layout(raw)
    except CloudError:
        raise
    except StateError as error:
        raise CloudError(f'the bytes are no PointCloud2: {error}') from None
    except struct.error:
        raise CloudError('the bytes are no PointCloud2: they end too early') from None


def points_of(raw: bytes, layout: CloudLayout, out: Array | None = None) -> Array:
    """Return the points (3, n) of a message: x, y and z of all of them, row by row [m].

    Args:
        raw: the message.
        layout: its layout.
        out: (3, n) to write to, for callers that read one cloud after another.
    """
    shape = layout.height, layout.width
    if out is None:
        out = np.empty((3, layout.height * layout.width))
    if not out.size:
        return out
    with np.errstate(invalid='ignore'):  # NaN of any kind is a point that was not seen
        for axis, (offset, kind) in enumerate(zip(layout.offsets, layout.kinds)):
            # NumPy makes sure that all of it lies within the message.
            out[axis].reshape(shape)[...] = np.ndarray(
                shape, kind, raw, layout.begin + offset, (layout.row_step, layout.point_step))
    return out


def _layout(raw: bytes) -> CloudLayout:
    order = byte_order(raw)
    seconds, nanoseconds, length = struct.unpack_from(f'{order}iII', raw, ENCAPSULATION)
    if nanoseconds >= _NANOSECONDS:
        raise CloudError(
            f'the nanosec of its stamp is {nanoseconds}; below {_NANOSECONDS} is right')
    at = ENCAPSULATION + 12
    frame = text(raw, at, length)
    at = _aligned(at + length)
    height, width, count = struct.unpack_from(f'{order}3I', raw, at)
    if count > _MOST_FIELDS:
        raise CloudError(f'it has {count} fields; up to {_MOST_FIELDS} are read')
    fields, at = _fields(raw, order, at + 12, count)
    big_endian = raw[at] if at < len(raw) else 0
    at = _aligned(at + 1)
    point_step, row_step, size = struct.unpack_from(f'{order}3I', raw, at)
    begin = at + 12
    data_order = '>' if big_endian else '<'
    used = _coordinates(fields, point_step)
    _check_size(height, width, point_step, row_step, size)
    if begin + size > len(raw):
        raise CloudError(f'the message ends too early: its data should have {size} bytes, and '
                         f'there are {len(raw) - begin}')
    return CloudLayout(
        seconds * _NANOSECONDS + nanoseconds, frame, height, width,
        tuple(field.offset for field in used),
        tuple(data_order + _NUMBERS[field.datatype] for field in used), point_step,
        row_step, begin)


def _fields(
    raw: bytes, order: str, at: int, count: int,
) -> tuple[dict[str, list[_Field]], int]:
    """Return the fields by their names, and where the message goes on."""
    fields: dict[str, list[_Field]] = {}
    for _ in range(count):
        at = _aligned(at)
        length, = struct.unpack_from(f'{order}I', raw, at)
        name = text(raw, at + 4, length)
        at = _aligned(at + 4 + length)
        offset, datatype = struct.unpack_from(f'{order}IB', raw, at)
        number, = struct.unpack_from(f'{order}I', raw, at + 8)
        fields.setdefault(name, []).append(_Field(offset, datatype, number))
        at += 12
    return fields, at


def _aligned(at: int) -> int:
    """Return the next offset at which a 32-bit number may stand."""
    return ENCAPSULATION + -(-(at - ENCAPSULATION) // 4) * 4


def _coordinates(fields: dict[str, list[_Field]], point_step: int) -> list[_Field]:
    """Return the fields x, y and z.

    Raises:
        CloudError: one is missing or cannot be read.
    """
    missing = [axis for axis in _AXES if axis not in fields]
    if missing:
        raise CloudError(f'it has no field {known(missing)}; it must have x, y and z, and has '
                         f'{known(fields)}')
    if point_step == 0:
        raise CloudError('its point_step is 0; it must be the size of a point in bytes')
    used = []
    for axis in _AXES:
        if len(fields[axis]) > 1:
            raise CloudError(f"its field '{axis}' appears {len(fields[axis])} times; it must "
                             'appear once')
        field = fields[axis][0]
        if field.datatype not in _NUMBERS:
            named = _DATATYPES.get(field.datatype, 'unknown')
            raise CloudError(f"its field '{axis}' has datatype {field.datatype} ({named}); it "
                             'must be 7 (FLOAT32) or 8 (FLOAT64), in metres')
        if field.numbers > 1:
            raise CloudError(f"its field '{axis}' has count {field.numbers}; it must be 1")
        end = field.offset + int(_NUMBERS[field.datatype][1:])
        if end > point_step:
            raise CloudError(f"its field '{axis}' ends at byte {end} of a point, and point_step "
                             f'is {point_step}; a point must hold all its fields')
        used.append(field)
    return used


def _check_size(height: int, width: int, point_step: int, row_step: int, size: int) -> None:
    """Make sure that the numbers of rows, points and bytes agree.

    Raises:
        CloudError: they do not.
    """
    if height * width > MOST_POINTS:
        raise CloudError(f'it has {height} × {width} points; up to {MOST_POINTS} are read')
    if row_step < width * point_step:
        raise CloudError(f'its row_step is {row_step}; a row of {width} points of {point_step} '
                         f'bytes takes {width * point_step}')
    if size != height * row_step:
        raise CloudError(f'its data has {size} bytes; {height} rows of {row_step} bytes take '
                         f'{height * row_step}')

"""Writes the bytes of a visualization_msgs/MarkerArray that holds one CUBE_LIST.

rclpy makes a Python object of every point: 20 ms for ten thousand.
"""

from __future__ import annotations

from collections.abc import Sequence
import struct

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# visualization_msgs/Marker's numbers.
CUBE_LIST = 6
_ADD, _DELETE = 0, 2
_NANOSECONDS = 1_000_000_000
_COLOR = (0.85, 0.35, 0.2, 0.8)  # red, green, blue, opacity
# What follows the points, all of it empty: colors, texture_resource, texture (stamp, frame_id,
# format, data), uv_coordinates, text, mesh_resource, mesh_file, mesh_use_embedded_materials.
_EMPTY_TEXT = b'\1\0\0\0\0\0\0\0'
_REST = (struct.pack('<I', 0) + _EMPTY_TEXT + struct.pack('<iI', 0, 0) + 2 * _EMPTY_TEXT
         + struct.pack('<II', 0, 0) + 3 * _EMPTY_TEXT + struct.pack('<IB', 0, 0))


def cube_list_bytes(
    namespace: str, frame: str, stamp_ns: int, size: float, centers: Array, *, number: int = 0,
    pose: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
) -> bytes:
    """Return a CDR-serialised MarkerArray with one marker of a namespace.

    Args:
        namespace: of the marker.
        frame: in which it is given.
        stamp_ns: of its header [ns].
        size: of the cubes [m].
        centers: (k, 3) of the cubes in the marker's pose [m]; for none, the marker says DELETE.
        number: of the marker, its id.
        pose: of the marker: x y z [m] and a quaternion x y z w.
    """
    head = struct.pack('<4sIiI', b'\0\1\0\0', 1, *divmod(stamp_ns, _NANOSECONDS))
    for name in (frame, namespace):
        encoded = name.encode()
        head += struct.pack(f'<I{len(encoded)}sx', len(encoded) + 1, encoded)
        head += bytes(-len(head) % 4)
    head += struct.pack('<3i', number, CUBE_LIST, _ADD if len(centers) else _DELETE)
    head = _aligned_to_numbers(head)
    head += struct.pack('<10d', *pose, size, size, size)
    # Colour, lifetime (unlimited) and frame_locked.
    head += struct.pack('<4fiI?3xI', *_COLOR, 0, 0, False, len(centers))
    if not len(centers):
        return head + _REST
    points = np.ascontiguousarray(centers, '<f8').tobytes()
    return _aligned_to_numbers(head) + points + _REST


def _aligned_to_numbers(head: bytes) -> bytes:
    """Return bytes with zeros up to where a 64-bit number may stand."""
    return head + bytes(-(len(head) - 4) % 8)

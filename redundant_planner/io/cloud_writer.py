"""Writes the bytes of a sensor_msgs/PointCloud2: organised, x y z as FLOAT32.

rclpy would make a Python object of the message first, and copy five megabytes thrice.
"""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt

from redundant_planner.io.cloud_layout import FLOAT32

Array = npt.NDArray[np.float64]

_NANOSECONDS = 1_000_000_000
# Three numbers and four bytes of nothing, as most drivers write them.
_POINT_STEP = 16


def cloud_bytes(points: Array, frame: str, stamp_ns: int) -> bytes:
    """Return a CDR-serialised PointCloud2.

    Args:
        points: (h, w, 3) in the frame, NaN where nothing was seen [m].
        frame: its name.
        stamp_ns: when they were seen [ns].
    """
    height, width = points.shape[:2]
    name = frame.encode()
    head = struct.pack(f'<4siII{len(name)}sx', b'\0\1\0\0', *divmod(stamp_ns, _NANOSECONDS),
                       len(name) + 1, name)
    head = _padded(head) + struct.pack('<3I', height, width, 3)
    for i, axis in enumerate(b'xyz'):
        # The name with its closing zero, aligned; offset, datatype and count.
        head += struct.pack('<IBB2xIB3xI', 2, axis, 0, 4 * i, FLOAT32, 1)
    data = np.zeros((height, width, _POINT_STEP // 4), '<f4')
    data[:, :, :3] = points
    head += struct.pack('<B3x3I', 0, _POINT_STEP, width * _POINT_STEP, data.nbytes)
    # is_dense says whether all points are there.
    return head + data.tobytes() + bytes([bool(np.isfinite(points).all())])


def _padded(head: bytes) -> bytes:
    """Return bytes with zeros up to where a 32-bit number may stand."""
    return head + bytes(-len(head) % 4)

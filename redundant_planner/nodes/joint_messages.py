"""Reads and writes the bytes of JointState messages, without a Python object for each.

rclpy takes 100 µs to make a message and to take it apart, a tenth of a core at 1 kHz.
"""

from __future__ import annotations

from collections.abc import Sequence
import struct

import numpy as np
import numpy.typing as npt
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from redundant_planner.io.joint_layout import joint_layout, JointLayout, STAMP
from redundant_planner.io.plausible import LARGEST
from redundant_planner.nodes.messages import NANOSECONDS, values_of

Array = npt.NDArray[np.float64]


class JointReader:
    """Reads the state of certain joints, in any order of the messages."""

    def __init__(self, joint_names: Sequence[str]) -> None:
        """Read the n joints of these names."""
        self._names = tuple(joint_names)
        self._known = b''
        self._layout: JointLayout | None = None
        self._numbers = struct.Struct('')
        self._index: list[int] = []

    def positions(self, raw: bytes) -> Array:
        """Return the positions (n,) in a CDR-serialised JointState [rad, m].

        Raises:
            StateError: the bytes are no JointState, or as `values_of`.
        """
        if self._layout is None or not self._layout.fits(raw, self._known):
            return self._learnt(raw)
        values = self._numbers.unpack_from(raw, self._layout.positions)
        q = [values[i] for i in self._index]
        if not all(-LARGEST <= value <= LARGEST for value in q):
            return values_of(self._layout.names, values, self._names, 'position')
        return np.array(q)

    def state(self, raw: bytes) -> tuple[int, Array, Array | None]:
        """Return stamp [ns], positions (n,) and velocities (n,) [rad, m; per s].

        Velocities are None if the message has none, or one that cannot be.

        Raises:
            StateError: as `positions`.
        """
        q = self.positions(raw)
        assert self._layout is not None  # it is that of this message now
        seconds, nanoseconds = struct.unpack_from(f'{self._layout.order}iI', raw, STAMP)
        stamp = seconds * NANOSECONDS + nanoseconds
        if not self._layout.velocities:
            return stamp, q, None
        values = self._numbers.unpack_from(raw, self._layout.velocities)
        dq = np.array([values[i] for i in self._index])
        return stamp, q, dq if (np.abs(dq) <= LARGEST).all() else None

    def _learnt(self, raw: bytes) -> Array:
        """Read a message with all checks, and remember its layout."""
        layout = joint_layout(raw)
        numbers = struct.Struct(f'{layout.order}{len(layout.names)}d')
        values = numbers.unpack_from(raw, layout.positions)
        q = values_of(layout.names, values, self._names, 'position')
        self._known, self._layout, self._numbers = bytes(raw), layout, numbers
        self._index = [layout.names.index(name) for name in self._names]
        return q


class JointWriter:
    """Writes positions and velocities of the same joints again and again, and maybe efforts."""

    def __init__(self, joint_names: Sequence[str], *, effort: bool = False) -> None:
        """Write the n joints of these names, with their efforts if that is asked for."""
        zeros = [0.0] * len(joint_names)
        self._bytes = bytearray(serialize_message(JointState(
            name=list(joint_names), position=zeros, velocity=zeros,
            effort=zeros if effort else [])))
        self._layout = joint_layout(bytes(self._bytes))
        self._stamp = struct.Struct(f'{self._layout.order}iI')
        self._numbers = struct.Struct(f'{self._layout.order}{len(zeros)}d')

    def message(
        self, stamp_ns: int, positions: Array, velocities: Array, efforts: Array | None = None,
    ) -> bytes:
        """Return a serialised JointState, to be published as it is.

        Args:
            stamp_ns: [ns].
            positions, velocities: (n,) [rad, m; per s].
            efforts: (n,) [Nm, N], for a writer of efforts.
        """
        self._stamp.pack_into(self._bytes, STAMP, *divmod(stamp_ns, NANOSECONDS))
        self._numbers.pack_into(self._bytes, self._layout.positions, *positions.tolist())
        self._numbers.pack_into(self._bytes, self._layout.velocities, *velocities.tolist())
        if efforts is not None:
            self._numbers.pack_into(self._bytes, self._layout.efforts, *efforts.tolist())
        return bytes(self._bytes)

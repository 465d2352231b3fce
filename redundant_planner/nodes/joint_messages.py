"""Reads and writes the bytes of JointState messages, without a Python object for each.

rclpy takes 100 µs to make a message and to take it apart, a tenth of a core at 1 kHz.
"""

from __future__ import annotations

from collections.abc import Sequence
import struct
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from redundant_planner.core.errors import known, StateError
from redundant_planner.io.joint_layout import joint_layout, JointLayout, LayoutError, STAMP
from redundant_planner.io.joint_turns import Seams, Unwrapping
from redundant_planner.io.plausible import LARGEST
from redundant_planner.nodes.messages import NANOSECONDS, values_of

Array = npt.NDArray[np.float64]

# Kinds of messages that are remembered: of so many publishers.
_MOST_KINDS = 16
_NONE = np.empty(0, dtype=np.intp)


class _Kind(NamedTuple):
    """A kind of messages, of one publisher's: their layout, and where our joints are in them.

    Attributes:
        raw: the first of them.
        layout: theirs.
        numbers: of all their joints.
        which: (k,) our joints that they have, by number.
        places: where these stand among theirs.
    """

    raw: bytes
    layout: JointLayout
    numbers: struct.Struct
    which: npt.NDArray[np.intp]
    places: tuple[int, ...]


class JointReader:
    """Reads the state of certain joints from messages that hold all of them, some or none.

    Of each joint the newest position counts. A driver may wrap it: positions are returned as the
    joint turns.

    Attributes:
        others: names in the latest message that had none of these joints.
    """

    def __init__(self, joint_names: Sequence[str], seams: Seams | None = None) -> None:
        """Read the n joints of these names; without seams no driver wraps their positions."""
        self._names = tuple(joint_names)
        self._kinds: list[_Kind] = []
        self._unwrapping = None if seams is None else Unwrapping(seams)
        self._measured = np.full(len(self._names), np.nan)
        self._posture = self._measured
        self.others: tuple[str, ...] = ()

    @property
    def posture(self) -> Array:
        """The newest position of each joint (n,) [rad, m]; NaN for one that none came of."""
        return self._posture

    @property
    def missing(self) -> tuple[str, ...]:
        """The joints that have no position yet."""
        return tuple(self._names[j] for j in np.flatnonzero(np.isnan(self._posture)))

    @property
    def turned(self) -> Array | float:
        """By how much the driver's positions are further than `posture` (n,) [rad]."""
        return 0.0 if self._unwrapping is None else self._unwrapping.turned

    def read(self, raw: bytes) -> npt.NDArray[np.intp]:
        """Take a CDR-serialised JointState; return which of the joints it has (k,).

        Raises:
            StateError: the bytes are no JointState, or as `values_of` for joints of ours. No
                joint has changed then.
        """
        kind = self._kind_of(raw)
        if kind is None or not kind.places:
            return _NONE
        values = kind.numbers.unpack_from(raw, kind.layout.positions)
        q = [values[i] for i in kind.places]
        if not all(-LARGEST <= value <= LARGEST for value in q):
            values_of(kind.layout.names, values, [self._names[j] for j in kind.which], 'position')
        if len(q) == len(self._names):
            measured = np.array(q)
        else:
            measured = self._measured.copy()
            measured[kind.which] = q
        self._measured = measured
        self._posture = (measured if self._unwrapping is None
                         else self._unwrapping.posture(measured))
        return kind.which

    def stamp_ns(self, raw: bytes) -> int:
        """Return the stamp of a message that was read, 0 for none [ns]."""
        kind = self._kind_of(raw)
        seconds, nanoseconds = struct.unpack_from(
            f'{kind.layout.order if kind else "<"}iI', raw, STAMP)
        return int(seconds) * NANOSECONDS + int(nanoseconds)

    def velocities(self, raw: bytes) -> Array | None:
        """Return the velocities (k,) of the joints in a message that was read [rad/s, m/s].

        None if it has none, or one that cannot be.
        """
        kind = self._kind_of(raw)
        if kind is None or not kind.layout.velocities:
            return None
        values = kind.numbers.unpack_from(raw, kind.layout.velocities)
        dq = np.array([values[i] for i in kind.places])
        return dq if (np.abs(dq) <= LARGEST).all() else None

    def _kind_of(self, raw: bytes) -> _Kind | None:
        """Return the kind of a message; None where it is one of other joints that has no layout.

        Raises:
            StateError: see `read`.
        """
        for kind in self._kinds:
            if kind.layout.fits(raw, kind.raw):
                if not kind.places:
                    self.others = kind.layout.names
                return kind
        try:
            layout = joint_layout(raw)
        except LayoutError as error:
            if error.names and not set(error.names).intersection(self._names):
                self.others = error.names
                return None
            raise
        names = layout.names
        ours = [j for j, name in enumerate(self._names) if name in names]
        twice = [self._names[j] for j in ours if names.count(self._names[j]) > 1]
        if twice:
            raise StateError(f'joint names appear twice: {known(twice)}')
        if not ours:
            self.others = names
        self._kinds.insert(0, _Kind(
            bytes(raw), layout, struct.Struct(f'{layout.order}{len(names)}d'),
            np.array(ours, dtype=np.intp), tuple(names.index(self._names[j]) for j in ours)))
        del self._kinds[_MOST_KINDS:]
        return self._kinds[0]


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

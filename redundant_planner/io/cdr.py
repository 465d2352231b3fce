"""What all serialised messages (CDR) have in common, and how much of one is read at most.

The readers of this package take bytes from anybody. Whatever the bytes are, they answer with the
content or with a StateError, and lengths that lie make them neither allocate nor loop.
"""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError

# Bytes before the payload, which alignment does not count.
ENCAPSULATION = 4
# Longest name of a joint, frame or namespace that is read [bytes].
LONGEST_NAME = 255
# Largest message that is read [bytes].
LARGEST_MESSAGE = 2**25


def byte_order(raw: bytes) -> str:
    """Return the order of a message's bytes, as struct and NumPy call it: '<' or '>'.

    Raises:
        StateError: it does not begin as plain CDR does, or is too long.
    """
    if len(raw) < ENCAPSULATION or raw[0] != 0 or raw[1] > 1:
        begin = bytes(raw[:ENCAPSULATION]).hex(' ') or 'nothing'
        raise StateError(f'it begins with {begin}; a message in plain CDR begins with '
                         '00 00 or 00 01 and two bytes more')
    if len(raw) > LARGEST_MESSAGE:
        raise StateError(f'it has {len(raw)} bytes; up to {LARGEST_MESSAGE} are read')
    return '<' if raw[1] else '>'


def words_and_doubles(
    raw: bytes, order: str,
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
    """Return the payload as unsigned 32-bit words, and the same as 64-bit numbers.

    Lengths and integers are aligned to words, numbers to eight bytes; what is left over at the
    end belongs to neither.
    """
    payload = raw[ENCAPSULATION:]  # a copy, as the numbers in the message are not aligned
    words = np.frombuffer(payload, f'{order}u4', len(payload) // 4).astype(np.intp)
    doubles = np.frombuffer(payload, f'{order}f8', len(payload) // 8)
    return words, doubles.astype(np.float64, copy=False)


def signed(words: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Return words as the signed integers that they are."""
    return (words ^ 2**31) - 2**31


def text(raw: bytes, begin: int, length: int) -> str:
    """Return a string by the offset of its first byte and its length, closing zero included.

    Raises:
        StateError: it is too long, the bytes end before, or they are not UTF-8.
    """
    if length > LONGEST_NAME + 1:
        raise StateError(f'a name in it has {length - 1} bytes; up to {LONGEST_NAME} are read')
    if begin + length > len(raw):
        raise StateError('the bytes end within a name')
    try:
        return bytes(raw[begin:begin + max(length - 1, 0)]).decode()
    except UnicodeDecodeError as error:
        raise StateError(f'a name in it is not UTF-8: {error}') from None


def header_of(raw: bytes, order: str) -> tuple[float, str, int]:
    """Return stamp [s] and frame of the header that a message begins with.

    Returns:
        Stamp, frame, and where in the payload the header ends.

    Raises:
        StateError: the bytes end before.
    """
    try:
        seconds, nanoseconds, length = struct.unpack_from(f'{order}iII', raw, ENCAPSULATION)
    except struct.error:
        raise StateError('the bytes end within the header') from None
    return seconds + nanoseconds / 1e9, text(raw, ENCAPSULATION + 12, length), 12 + length

"""Reads a serialised MarkerArray straight into arrays.

rclpy makes a Python object of every field of every marker: 50 µs per marker on the machine this
was written on, 50 ms for a thousand, in which no tick can run. An obstacle needs nine numbers of
some sixty. A compiled walk over the lengths in the message finds them, whatever lies in between.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError
from redundant_planner.core.kernels import compiled, IndexPairs, Indices, Vector
from redundant_planner.io.cdr import (
    byte_order,
    ENCAPSULATION,
    LONGEST_NAME,
    signed,
    text,
    words_and_doubles,
)

Array = npt.NDArray[np.float64]

# The numbers of visualization_msgs/Marker that count here; MODIFY is the same as ADD.
CUBE, SPHERE, CYLINDER, LINE_STRIP, LINE_LIST, CUBE_LIST, SPHERE_LIST, POINTS = range(1, 9)
ADD, DELETE, DELETEALL = 0, 2, 3

# Markers that a message may have.
MOST_MARKERS = 20_000

# What the walk finds of a marker, in words of the payload: where it begins, where the characters
# of its frame, namespace and text are and their number of bytes, where the other fields are, and
# how many points it has.
(_BEGIN, _FRAME, _FRAME_LENGTH, _NAMESPACE, _NAMESPACE_LENGTH, _NUMBERS, _POSE, _LIFETIME, _POINTS,
 _POINT_COUNT, _TEXT, _TEXT_LENGTH, _COLUMNS) = range(13)
_POSE_WORDS, _COLOR_WORDS = 20, 4  # position, orientation and scale; colour
_NO_POINTS: Array = np.empty((0, 3))
# What a text begins with that says how fast a thing moves, and how many characters it may have.
_TWIST, _LONGEST_TWIST = b'twist ', 300


class Listing(NamedTuple):
    """Who the k markers of a message are, and what is to be done with them.

    Attributes:
        frames, namespaces: k strings.
        ids, types, actions: (k,).
    """

    frames: list[str]
    namespaces: list[str]
    ids: npt.NDArray[np.intp]
    types: npt.NDArray[np.intp]
    actions: npt.NDArray[np.intp]


class Markers(NamedTuple):
    """The k markers of a message, in its order.

    Attributes:
        listing: who they are; the same object as in the message before if that listed the same.
        stamps: (k,) of the headers [s], 0 where there is none.
        positions: (k, 3) [m].
        quaternions: (k, 4) x y z w.
        scales: (k, 3) full extents [m].
        lifetimes: (k,) [s], 0 for unlimited.
        points: k arrays (p, 3), what markers that list many things have [m].
        twists: (k, 6) velocities and angular velocities as their texts say: NaN where one says
            nothing of it, ∞ where it is no twist [m/s, rad/s]. None if no text says anything.
    """

    listing: Listing
    stamps: Array
    positions: Array
    quaternions: Array
    scales: Array
    lifetimes: Array
    points: list[Array]
    twists: Array | None


class MarkerReader:
    """Reads one message after another; names that stay the same are read once."""

    def __init__(self) -> None:
        """Begin without a message."""
        # The last message's words, what the walk found in them, and its listing.
        self._last: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], Listing] | None = None

    def read(self, raw: bytes) -> Markers:
        """Return the markers of a CDR-serialised visualization_msgs/MarkerArray.

        Raises:
            StateError: the bytes are no such message, or it is larger than what is read.
        """
        try:
            order = byte_order(raw)
            count = _count(raw, order)
            words, doubles = words_and_doubles(raw, order)
            found = _found(words, len(raw) - ENCAPSULATION, count)
            if self._last is None or order != '<' or not _lists_the_same(
                    words, found, self._last[0], self._last[1]):
                self._last = words, found, _listing(raw, words, found)
        except StateError as error:
            raise StateError(f'the bytes are no MarkerArray that can be used: {error}') from None
        pose = _poses(doubles, found)
        return Markers(
            self._last[2], _seconds(words, found[:, _BEGIN]), pose[:, :3], pose[:, 3:7],
            pose[:, 7:], _seconds(words, found[:, _LIFETIME]), _points(doubles, found),
            _twists(raw, found))


def places_in(raw: bytes) -> list[tuple[int, int, int, int]]:
    """Return where the markers of a message have stamp, pose, points and text.

    In words from the end of the encapsulation on.

    Args:
        raw: a sound little-endian MarkerArray.
    """
    words, _ = words_and_doubles(raw, '<')
    found = _found(words, len(raw) - ENCAPSULATION, _count(raw, '<'))
    return [(int(row[_BEGIN]), int(row[_POSE]), int(row[_POINTS]), int(row[_TEXT]))
            for row in found]


def _count(raw: bytes, order: str) -> int:
    """Return how many markers there are to read.

    Raises:
        StateError: too many, or the bytes end before the number.
    """
    if len(raw) < ENCAPSULATION + 4:
        raise StateError('it is empty')
    count = int(struct.unpack_from(f'{order}I', raw, ENCAPSULATION)[0])
    if count > MOST_MARKERS:
        raise StateError(f'it has {count} markers; up to {MOST_MARKERS} are read')
    return count


def _found(words: npt.NDArray[np.intp], size: int, count: int) -> npt.NDArray[np.intp]:
    """Return where the markers of a payload of `size` bytes have what (k, `_COLUMNS`).

    Raises:
        StateError: the payload ends within a marker, or a name is too long.
    """
    found = _walk(words, size, count)
    if len(found) < count:
        raise StateError(f'it ends within marker {len(found)} of {count}')
    longest = int(found[:, (_FRAME_LENGTH, _NAMESPACE_LENGTH)].max(initial=0)) - 1
    if longest > LONGEST_NAME:
        raise StateError(f'a frame or namespace has {longest} bytes; up to {LONGEST_NAME} are '
                         'read')
    return found


@compiled
def _after(words: Indices, at: int, alignment: int, size: int) -> int:
    """Return the word after a string or sequence, whose length stands at a word.

    Args:
        words: of the payload.
        at: where the length stands; if that is behind the end, so is the answer.
        alignment: of the entries, in words.
        size: of an entry in bytes.
    """
    if at >= len(words):
        return at
    count = words[at]
    at += 1
    if count and at % alignment:
        at += 1
    return at + (count * size + 3) // 4


@compiled
def _walk(words: Indices, size: int, count: int) -> Indices:
    """Return what `_found` does, of the markers that the payload does not end within."""
    found = np.empty((count, _COLUMNS), np.intp)
    at, end = 1, len(words)
    for i in range(count):
        marker = found[i]
        marker[_BEGIN] = at
        at += 2
        for name, length in ((_FRAME, _FRAME_LENGTH), (_NAMESPACE, _NAMESPACE_LENGTH)):
            marker[name], marker[length] = at + 1, words[at] if at < end else 0
            at = _after(words, at, 1, 1)
        marker[_NUMBERS] = at
        marker[_POSE] = at + 3 + (at + 3) % 2
        marker[_LIFETIME] = marker[_POSE] + _POSE_WORDS + _COLOR_WORDS
        at = marker[_LIFETIME] + 3  # with frame_locked
        marker[_POINTS] = at + 1 + (at + 1) % 2
        marker[_POINT_COUNT] = words[at] if at < end else 0
        at = _after(words, at, 2, 24)  # points
        at = _after(words, at, 1, 16)  # colors
        at = _after(words, at, 1, 1)  # texture_resource
        at = _after(words, at + 2, 1, 1)  # texture: stamp and frame
        at = _after(words, at, 1, 1)  # its format
        at = _after(words, at, 1, 1)  # its data
        at = _after(words, at, 1, 8)  # uv_coordinates
        marker[_TEXT], marker[_TEXT_LENGTH] = at + 1, words[at] if at < end else 0
        at = _after(words, at, 1, 1)  # text
        at = _after(words, at, 1, 1)  # mesh_resource
        at = _after(words, at, 1, 1)  # mesh_file: its name
        if at >= end:
            return found[:i]
        last = 4 * (at + 1) + words[at]  # its data, and then mesh_use_embedded_materials
        if last + 1 > size:
            return found[:i]
        at = last // 4 + 1
    return found


@compiled
def _poses(doubles: Vector, found: IndexPairs) -> Vector:
    """Return position, orientation and scale of all markers (k, 10)."""
    poses = np.empty((len(found), _POSE_WORDS // 2))
    for i in range(len(found)):
        for j in range(_POSE_WORDS // 2):
            poses[i, j] = doubles[found[i, _POSE] // 2 + j]
    return poses


def _points(doubles: Array, found: npt.NDArray[np.intp]) -> list[Array]:
    """Return the points of every marker."""
    counts = found[:, _POINT_COUNT]
    if not counts.any():
        return [_NO_POINTS] * len(found)
    return [doubles[at:at + 3 * count].reshape(-1, 3) for at, count in zip(
        (found[:, _POINTS] // 2).tolist(), counts.tolist())]


def _twists(raw: bytes, found: npt.NDArray[np.intp]) -> Array | None:
    """Return what the texts of all markers say of their twists, see `Markers`."""
    lengths = found[:, _TEXT_LENGTH]
    if not (lengths > len(_TWIST)).any():
        return None
    twists = np.full((len(found), 6), np.nan)
    for i in np.flatnonzero(lengths > len(_TWIST)).tolist():
        begin = ENCAPSULATION + 4 * int(found[i, _TEXT])
        if raw[begin:begin + len(_TWIST)] == _TWIST:
            twists[i] = _twist_of(raw[begin + len(_TWIST):begin + int(lengths[i]) - 1])
    return None if np.isnan(twists).all() else twists


def _twist_of(written: bytes) -> Array:
    """Return the twist (6,) that is written; ∞ where there is none."""
    try:
        twist = np.array(written[:_LONGEST_TWIST].split(), dtype=float)
    except ValueError:
        return np.full(6, np.inf)
    return twist if twist.shape == (6,) and np.isfinite(twist).all() else np.full(6, np.inf)


@compiled
def _lists_the_same(
    words: Indices, found: IndexPairs, other: Indices, found_there: IndexPairs,
) -> bool:
    """Return whether two little-endian messages have the same names, ids, types and actions."""
    if len(found) != len(found_there):
        return False
    for i in range(len(found)):
        here, there = found[i], found_there[i]
        for j in range(3):
            if words[here[_NUMBERS] + j] != other[there[_NUMBERS] + j]:
                return False
        for name, length in ((_FRAME, _FRAME_LENGTH), (_NAMESPACE, _NAMESPACE_LENGTH)):
            count = here[length]
            if count != there[length]:
                return False
            for j in range(count // 4):
                if words[here[name] + j] != other[there[name] + j]:
                    return False
            if count % 4:  # what follows in the last word is not part of the name
                different = words[here[name] + count // 4] ^ other[there[name] + count // 4]
                if different & ((1 << 8 * (count % 4)) - 1):
                    return False
    return True


def _listing(
    raw: bytes, words: npt.NDArray[np.intp], found: npt.NDArray[np.intp],
) -> Listing:
    ids, types, actions = (signed(words[found[:, _NUMBERS] + i]) for i in range(3))
    frames, namespaces = (
        _strings(raw, words, found[:, name], found[:, length]) for name, length in (
            (_FRAME, _FRAME_LENGTH), (_NAMESPACE, _NAMESPACE_LENGTH)))
    return Listing(frames, namespaces, ids, types, actions)


def _strings(
    raw: bytes, words: npt.NDArray[np.intp], places: npt.NDArray[np.intp],
    lengths: npt.NDArray[np.intp],
) -> list[str]:
    """Return the strings at some words, whose lengths count their closing zeros."""
    begins = ENCAPSULATION + 4 * places
    ends = begins + np.maximum(lengths - 1, 0)
    if len(places) and (lengths == lengths[0]).all():
        characters = words[places[:, None] + np.arange(-(-lengths[0] // 4))]
        if (characters == characters[0]).all():  # as is usual, there is but one
            return [text(raw, int(begins[0]), int(lengths[0]))] * len(places)
    values = [raw[begin:end] for begin, end in zip(begins.tolist(), ends.tolist())]
    try:
        decoded = {value: value.decode() for value in set(values)}
    except UnicodeDecodeError as error:
        raise StateError(f'a name in it is not UTF-8: {error}') from None
    return [decoded[value] for value in values]


def _seconds(words: npt.NDArray[np.intp], places: npt.NDArray[np.intp]) -> Array:
    return np.asarray(signed(words[places]) + 1e-9 * words[places + 1])

"""Reads a serialised MarkerArray straight into arrays.

rclpy makes a Python object of every field of every marker: 50 µs per marker on the machine this
was written on, 50 ms for a thousand, in which no tick can run. An obstacle needs nine numbers of
some sixty, and markers of one message nearly always have names of the same length, so that all
fields lie at the same distance from one marker to the next: a thousand then take as long as one.
"""

from __future__ import annotations

from collections.abc import Iterator
import struct
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError

Array = npt.NDArray[np.float64]

# The numbers of visualization_msgs/Marker that count here; MODIFY is the same as ADD.
CUBE, SPHERE, CYLINDER = 1, 2, 3
ADD, DELETE, DELETEALL = 0, 2, 3

_ENCAPSULATION = 4  # bytes before the payload, which alignment does not count
# What follows frame_locked, by the alignment and size of the entries: points, colors,
# texture_resource, then texture's frame_id (after its stamp), format and data, uv_coordinates,
# text, mesh_resource and the mesh file's name and data.
_BEFORE_TEXTURE = ((8, 24), (4, 16), (1, 1))
_AFTER_TEXTURE = ((1, 1), (1, 1), (1, 1), (4, 8), (1, 1), (1, 1), (1, 1), (1, 1))
_STAMP = 8
_POSE, _COLOR = 80, 16  # position, orientation and scale; colour


class Markers(NamedTuple):
    """The k markers of a message, in its order.

    Attributes:
        frames, namespaces: k strings.
        ids, types, actions: (k,).
        stamps: (k,) of the headers [s], 0 where there is none.
        positions: (k, 3) [m].
        quaternions: (k, 4) x y z w.
        scales: (k, 3) full extents [m].
        lifetimes: (k,) [s], 0 for unlimited.
        places: (k, 3) where stamp, pose and lifetime lie in the payload.
        fixed: where the bytes lie there that tell layout, names, ids, types and actions.
    """

    frames: list[str]
    namespaces: list[str]
    ids: npt.NDArray[np.intp]
    types: npt.NDArray[np.intp]
    actions: npt.NDArray[np.intp]
    stamps: Array
    positions: Array
    quaternions: Array
    scales: Array
    lifetimes: Array
    places: npt.NDArray[np.intp]
    fixed: npt.NDArray[np.intp]


class MarkerReader:
    """Reads one message after another; of those that differ in numbers alone, only these."""

    def __init__(self) -> None:
        """Begin without a message."""
        self._markers: Markers | None = None

    def read(self, raw: bytes) -> Markers:
        """Return the markers of a CDR-serialised visualization_msgs/MarkerArray.

        Where layout, names, ids, types and actions are those of the last message, they are
        the very same objects again.

        Raises:
            StateError: the bytes are no such message.
        """
        block = np.frombuffer(raw, np.uint8)
        if self._markers is None or len(block) != len(self._fixed) or (
                (block ^ self._fixed) & self._mask).any():
            self._markers = None
            markers = read_markers(raw)
            self._learn(block, markers)
            return markers
        poses = np.frombuffer(raw, self._order + 'f8', self._count // 8, _ENCAPSULATION)[
            self._poses]
        words = np.frombuffer(raw, self._order + 'u4', self._count // 4, _ENCAPSULATION)[
            self._times]
        times = words[:, ::2] + 1e-9 * words[:, 1::2]
        return self._markers._replace(
            stamps=times[:, 0], positions=poses[:, :3], quaternions=poses[:, 3:7],
            scales=poses[:, 7:], lifetimes=times[:, 1])

    def _learn(self, block: npt.NDArray[np.uint8], markers: Markers) -> None:
        """Remember where the numbers lie, and which bytes tell that they lie there again."""
        self._markers, self._fixed = markers, block.copy()
        self._order = '<' if block[1] & 1 else '>'
        self._count = len(block) - _ENCAPSULATION
        stamps, poses, lifetimes = markers.places.T[:, :, None]
        self._poses = poses // 8 + np.arange(_POSE // 8)
        self._times = np.hstack((stamps // 4 + np.arange(2), lifetimes // 4 + np.arange(2)))
        self._mask = np.zeros(len(block), np.uint8)
        self._mask[_ENCAPSULATION + markers.fixed] = 255
        self._mask[1], self._mask[_ENCAPSULATION:_ENCAPSULATION + 4] = 255, 255


class _Layout(NamedTuple):
    """Where one marker's fields lie in the payload, counted from the marker's own start.

    Attributes:
        counts: offsets of all lengths of strings and sequences.
        frame, namespace: offsets of the strings' characters.
        numbers: offset of id, type and action.
        pose, lifetime: offsets.
        end: of the marker itself.
        size: with the bytes up to the next marker.
    """

    counts: tuple[int, ...]
    frame: int
    namespace: int
    numbers: int
    pose: int
    lifetime: int
    end: int
    size: int


def read_markers(raw: bytes) -> Markers:
    """Return the markers of a CDR-serialised visualization_msgs/MarkerArray.

    Raises:
        StateError: the bytes are no such message.
    """
    try:
        return _joined(list(_runs(raw)))
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise StateError(f'the bytes are no MarkerArray: {error}') from None


def _runs(raw: bytes) -> Iterator[tuple[slice, Markers]]:
    """Yield markers of the same layout together, with their places in the message.

    Numbers of eight bytes are aligned to eight: where a marker's size is an odd multiple of
    four, every second one has the same layout.
    """
    order = '<' if raw[1] & 1 else '>'
    payload = memoryview(raw)[_ENCAPSULATION:]
    count = struct.unpack_from(order + 'I', payload, 0)[0]
    at, done = 4, 0
    while done < count:
        layouts = [_layout(payload, at, order)]
        if layouts[0].size % 8 and done + 1 < count:
            layouts.append(_layout(payload, at + layouts[0].size, order))
        step, stride = len(layouts), sum(layout.size for layout in layouts)
        views, start = [], at
        for layout in layouts:
            views.append(_view(payload, start, layout, stride, (count - done) // step, order))
            start += layout.size
        length = min(_same(view) for view in views)
        for i, view in enumerate(views):
            first = done + i
            begins = at + sum(other.size for other in layouts[:i]) + stride * np.arange(length)
            layout = layouts[i]
            places = np.column_stack(
                (begins, begins + layout.pose, begins + layout.lifetime))
            fixed = np.concatenate([
                *(np.arange(at, at + 4) for at in layout.counts),
                np.arange(layout.frame, layout.frame + view.dtype['frame'].itemsize),
                np.arange(layout.namespace, layout.namespace + view.dtype['namespace'].itemsize),
                np.arange(layout.numbers, layout.numbers + 12)])
            yield (slice(first, first + step * length, step),
                   _markers(view[:length], places, (begins[:, None] + fixed).ravel()))
        at, done = at + stride * length, done + step * length


def _layout(payload: memoryview, at: int, order: str) -> _Layout:
    """Walk through the marker at an offset of the payload."""
    counts = []
    here = at + _STAMP

    def skip(alignment: int, size: int) -> int:
        """Move past a string or sequence; return where its entries begin."""
        nonlocal here
        here = -(-here // 4) * 4
        number = struct.unpack_from(order + 'I', payload, here)[0]
        counts.append(here - at)
        here += 4
        if number:
            here = -(-here // alignment) * alignment
        begin = here
        here += number * size
        return begin

    frame, namespace = skip(1, 1), skip(1, 1)
    numbers = here = -(-here // 4) * 4
    pose = -(-(here + 12) // 8) * 8
    lifetime = pose + _POSE + _COLOR
    here = lifetime + 8 + 1
    for alignment, size in _BEFORE_TEXTURE:
        skip(alignment, size)
    here = -(-here // 4) * 4 + _STAMP
    for alignment, size in _AFTER_TEXTURE:
        skip(alignment, size)
    here += 1
    if here > len(payload):
        raise IndexError('it ends in the middle of a marker')
    return _Layout(tuple(counts), frame - at, namespace - at, numbers - at, pose - at,
                   lifetime - at, here - at, -(-here // 4) * 4 - at)


def _view(
    payload: memoryview, at: int, layout: _Layout, stride: int, count: int, order: str,
) -> npt.NDArray[Any]:
    """Return the markers from an offset on as records, as if all had the same layout."""
    fits = max((len(payload) - at - layout.end) // stride + 1, 1)
    frame, namespace = (
        struct.unpack_from(order + 'I', payload, at + offset)[0] for offset in layout.counts[:2])
    fields: dict[str, tuple[Any, int]] = {
        'stamp': ((order + 'u4', 2), 0),
        'frame': (f'S{max(frame - 1, 1)}', layout.frame),
        'namespace': (f'S{max(namespace - 1, 1)}', layout.namespace),
        'numbers': ((order + 'i4', 3), layout.numbers),
        'pose': ((order + 'f8', 10), layout.pose),
        'lifetime': ((order + 'u4', 2), layout.lifetime)}
    fields.update({f'count{i}': (order + 'u4', offset)
                   for i, offset in enumerate(layout.counts)})
    record = np.dtype({
        'names': list(fields), 'formats': [kind for kind, _ in fields.values()],
        'offsets': [offset for _, offset in fields.values()], 'itemsize': layout.end})
    return np.ndarray((min(fits, max(count, 1)),), record, payload, at, (stride,))


def _same(view: npt.NDArray[Any]) -> int:
    """Return how many records from the first on have its lengths, and so its layout."""
    same = np.ones(len(view), dtype=bool)
    for name in view.dtype.names or ():
        if name.startswith('count'):
            same &= view[name] == view[name][0]
    return len(view) if same.all() else int(same.argmin())


def _markers(
    view: npt.NDArray[Any], places: npt.NDArray[np.intp], fixed: npt.NDArray[np.intp],
) -> Markers:
    numbers, pose = view['numbers'].astype(np.intp), view['pose'].astype(np.float64)
    return Markers(
        _strings(view, 'frame', 0), _strings(view, 'namespace', 1),
        numbers[:, 0], numbers[:, 1], numbers[:, 2], _seconds(view['stamp']),
        pose[:, :3], pose[:, 3:7], pose[:, 7:], _seconds(view['lifetime']), places,
        fixed)


def _strings(view: npt.NDArray[Any], field: str, count: int) -> list[str]:
    if view[f'count{count}'][0] <= 1:  # nothing but the closing zero
        return [''] * len(view)
    values = view[field].tolist()
    decoded = {value: value.decode() for value in set(values)}  # mostly a single one
    return [decoded[value] for value in values]


def _seconds(stamps: npt.NDArray[Any]) -> Array:
    return stamps[:, 0] + 1e-9 * stamps[:, 1]


def _joined(runs: list[tuple[slice, Markers]]) -> Markers:
    """Put the runs' markers in their places."""
    if len(runs) == 1:
        return runs[0][1]
    count = sum(len(markers.ids) for _, markers in runs)
    joined = Markers(
        [''] * count, [''] * count, np.zeros(count, np.intp), np.zeros(count, np.intp),
        np.zeros(count, np.intp), np.zeros(count), np.zeros((count, 3)), np.zeros((count, 4)),
        np.zeros((count, 3)), np.zeros(count), np.zeros((count, 3), np.intp),
        np.concatenate([markers.fixed for _, markers in runs] or [np.empty(0, np.intp)]))
    for places, markers in runs:
        for target, source in zip(joined[:-1], markers):
            target[places] = source  # type: ignore[index]
    return joined

"""The target of a recorded tick, as numbers at the end of its row."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError
from redundant_planner.core.robot.se3 import checked_pose, Pose
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import Goal, TipTargets
from redundant_planner.core.target.moving_target import Sighting

Array = npt.NDArray[np.float64]

# What is added to the kind of a row that ends with a pose (position and rotation matrix), joint
# positions, or a chunk, which only its first tick has; of further ticks along the same chunk.
_WITH_POSE, _WITH_JOINTS, _WITH_CHUNK, _WITH_SAME_CHUNK, _STEP = 20, 40, 60, 80, 20
_POSE = 12
# The last numbers of a chunk: how late it was, its points, numbers of each, and a code of what
# they are.
_CHUNK_END = 4
_POSITIONS, _VELOCITIES, _POSES = range(3)
# Of several tips, one with a chunk has NaN in place of its pose but for its second number: whether
# that is the chunk of the tick before. The others' numbers come before the poses.
_NEW, _SAME, _CODE_AT = 0.0, 1.0, 1
# What is added where targets came before the tick: they come after the target, each with the age
# of its stamp (NaN for none), and then their count. Older rows have none.
_WITH_NEWS, _KINDS = 5, 10


class RecordedTarget(NamedTuple):
    """What a row says of the target.

    Attributes:
        target: that commands the arm in place of the twist; None for none, or where `goes_on`. Of
            an arm with several tips each is in it, in their order, with its pose, chunk or None.
        goes_on: whether the latest chunk that was a target is the target still.
        news: see `Planner.step`.
        tips_go_on: tips of which the latest chunk is the target still; `target` has None for them.
    """

    target: Goal | Chunk | TipTargets | None = None
    goes_on: bool = False
    news: tuple[Sighting, ...] = ()
    tips_go_on: tuple[str, ...] = ()

    def numbers(self) -> tuple[int, Array]:
        """Return what is added to the row's kind, and its numbers."""
        target = self.target
        if isinstance(target, Chunk):
            return _WITH_CHUNK, _numbers_of_chunk(target)
        if target is None:
            return _WITH_SAME_CHUNK * self.goes_on, np.empty(0)
        kind = _WITH_JOINTS if isinstance(target, np.ndarray) else _WITH_POSE
        numbers = (self._numbers_of_tips(target) if isinstance(target, Mapping) else
                   _numbers(target))
        if not self.news:
            return kind, numbers
        tips = tuple(target) if isinstance(target, Mapping) else ()
        parts = [numbers]
        for seen, age in self.news:
            parts += [_numbers(_of_all(seen, tips)), np.array([np.nan if age is None else age])]
        return kind + _WITH_NEWS, np.concatenate((*parts, (len(self.news),)))

    def _numbers_of_tips(self, target: TipTargets) -> Array:
        """Return targets of tips as numbers, chunks before poses."""
        chunks, poses = [], []
        for tip, at in target.items():
            place = np.full(_POSE, np.nan)
            if isinstance(at, Pose):
                place = _numbers(at)
            elif isinstance(at, Chunk):
                chunks.append(_numbers_of_chunk(at))
                place[_CODE_AT] = _NEW
            elif tip in self.tips_go_on:
                place[_CODE_AT] = _SAME
            poses.append(place)
        return np.concatenate((*chunks, *poses))


def parted(
    row: Array, kind: int, n: int, tips: Sequence[str] = (),
) -> tuple[Array, int, RecordedTarget]:
    """Return a row and its kind without the target, and that.

    Args:
        row: with the target's numbers at its end.
        kind: of the row, less than 100.
        n: joints of the arm.
        tips: of an arm with several that are not coupled, each with a target of its own.

    Raises:
        StateError: there is no such target.
    """
    news: tuple[Sighting, ...] = ()
    what = kind // _STEP * _STEP
    width = {_WITH_POSE: _POSE * max(len(tips), 1), _WITH_JOINTS: n}.get(what, 0)

    def read(numbers: Array) -> Goal | TipTargets:
        return (_tip_poses(numbers, tips) if tips and what == _WITH_POSE else
                _target(numbers, pose=what == _WITH_POSE))

    if width and kind % _KINDS >= _WITH_NEWS:
        row, news = _news_parted(row, width, read)
        kind -= _WITH_NEWS
    if what == _WITH_CHUNK:
        row, chunk = _chunk_parted(row)
        return row, kind - what, RecordedTarget(chunk)
    if len(row) < width:
        raise StateError(f'a recorded tick has {row.size} numbers, and {width} of a target')
    row, end = np.split(row, [len(row) - width])
    if tips and what == _WITH_POSE:
        row, aimed = _tip_targets(row, end, tips)
        return row, kind - what, aimed._replace(news=news)
    target = read(end) if width else None
    return row, kind - what, RecordedTarget(target, what == _WITH_SAME_CHUNK, news)


def _numbers(target: Goal | TipTargets) -> Array:
    if isinstance(target, Mapping):
        return np.concatenate([
            _numbers(pose) if isinstance(pose, Pose) else np.full(_POSE, np.nan)
            for pose in target.values()])
    if isinstance(target, Pose):
        return np.concatenate((target.position, target.rotation.ravel()))
    return target


def _of_all(target: Goal | TipTargets, tips: Sequence[str]) -> Goal | TipTargets:
    """Return a target with all tips in it, if it is one of tips."""
    return {tip: target.get(tip) for tip in tips} if isinstance(target, Mapping) else target


def _tip_poses(numbers: Array, tips: Sequence[str]) -> dict[str, Pose | Chunk | None]:
    """Return the poses of several tips of their numbers; StateError if they are none."""
    return {tip: None if np.isnan(np.delete(pose, _CODE_AT)).all() else checked_pose(
                Pose(pose[:3], pose[3:].reshape(3, 3)))
            for tip, pose in zip(tips, numbers.reshape(len(tips), _POSE))}


def _tip_targets(
    row: Array, places: Array, tips: Sequence[str],
) -> tuple[Array, RecordedTarget]:
    """Return a row without the chunks of tips at its end, and the targets of all tips.

    Args:
        row: without the tips' poses.
        places: these.
        tips: all of them.

    Raises:
        StateError: there are no such targets.
    """
    targets = _tip_poses(places, tips)
    codes = places.reshape(len(tips), _POSE)[:, _CODE_AT]
    for tip, code in reversed(tuple(zip(tips, codes))):
        if targets[tip] is None and code == _NEW:
            row, targets[tip] = _chunk_parted(row)
    return row, RecordedTarget(targets, tips_go_on=tuple(
        tip for tip, code in zip(tips, codes) if targets[tip] is None and code == _SAME))


def _target(numbers: Array, *, pose: bool) -> Pose | Array:
    """Return a target of its numbers; StateError if they are none."""
    if pose:
        return checked_pose(Pose(numbers[:3], numbers[3:].reshape(3, 3)))
    if not np.isfinite(numbers).all():
        raise StateError('a recorded tick has a target that is not finite')
    return numbers


def _news_parted(
    row: Array, width: int, read: Callable[[Array], Goal | TipTargets],
) -> tuple[Array, tuple[Sighting, ...]]:
    """Return a row without the targets of some numbers that came before the tick, and these."""
    count = row[-1] if len(row) else 0.0
    size = (width + 1) * count
    if not (width and count >= 1.0 and count == round(count) and size < len(row)):
        raise StateError(f'a recorded tick has {count:g} targets; it must be a whole number of '
                         'those that its row has')
    begin = len(row) - 1 - int(size)
    return row[:begin], tuple(
        Sighting(read(item[:-1]), None if np.isnan(item[-1]) else float(item[-1]))
        for item in row[begin:-1].reshape(int(count), width + 1))


def _numbers_of_chunk(chunk: Chunk) -> Array:
    """Return a chunk as numbers, the last of which say how many there are."""
    poses = isinstance(chunk.points, tuple)
    points = np.array([_numbers(point) for point in chunk.points])
    code = _POSES if poses else _POSITIONS if chunk.velocities is None else _VELOCITIES
    return np.concatenate((
        chunk.times, points.ravel(),
        np.empty(0) if chunk.velocities is None else chunk.velocities.ravel(),
        (chunk.late, *points.shape, code)))


def _chunk_parted(row: Array) -> tuple[Array, Chunk]:
    """Return a row without the chunk at its end, and that; StateError if it is none."""
    if len(row) < _CHUNK_END:
        raise StateError(f'a recorded tick has {row.size} numbers, and a chunk of points')
    late, count, width, code = row[-_CHUNK_END:].tolist()
    size = count * (1 + width * (1 + (code == _VELOCITIES)))
    if not (count >= 1.0 and width >= 1.0 and 0.0 < size <= len(row) - _CHUNK_END
            and size == int(size)) or (code == _POSES and width != _POSE):
        raise StateError(f'a recorded tick has a chunk of {count:g} points with {width:g} numbers '
                         f'each, and {row.size} numbers')
    begin = len(row) - _CHUNK_END - int(size)
    times, rows = np.split(row[begin:-_CHUNK_END], [int(count)])
    rows = rows.reshape(-1, int(width))
    points, more = rows[:int(count)], rows[int(count):]
    if code == _POSES:
        return row[:begin], Chunk(times, [
            Pose(pose[:3], pose[3:].reshape(3, 3)) for pose in points], late=late)
    return row[:begin], Chunk(times, points, more if len(more) else None, late)

"""An MCAP file, read without trust in what it says of itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
import heapq
from itertools import chain
from operator import itemgetter
from pathlib import Path
import struct
from typing import BinaryIO, NamedTuple
import zlib

import numpy as np

from redundant_planner.io.bag_storage import LATEST, Message
from redundant_planner.io.mcap_records import (
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    FOOTER,
    HEAD,
    MCAP,
    MESSAGE,
    messages_in,
    records,
    SCHEMA,
    STATISTICS,
    text_at,
)
from redundant_planner.io.printable import printable
from redundant_planner.io.unpacking import DamageError, unpacked

# Records outside of chunks are read in blocks of this size [bytes].
_BLOCK = 1_000_000
# Chunks whose times overlap are merged while all of them together are smaller [bytes].
_MERGED = 512_000_000


class _Block(NamedTuple):
    """A stretch of an MCAP file whose messages are read together.

    Attributes:
        begin, size: of its bytes in the file.
        compression: 'zstd', 'lz4' or none.
        unpacked: its size without compression.
        checksum: of its bytes without compression, 0 for none.
        earliest, latest: of its messages [ns].
        channels: of its messages.
    """

    begin: int
    size: int
    compression: str
    unpacked: int
    checksum: int
    earliest: int = 0
    latest: int = 0
    channels: frozenset[int] = frozenset()


class McapFile:
    """An MCAP file: a series of records, in chunks or outside, each with its kind and length.

    Attributes:
        closed: whether all of it could be walked through, to its end.
        broken: whether it has its end, but could not be walked through.
        whole: where the last whole record ends [bytes].
    """

    def __init__(self, path: Path) -> None:
        """Walk through the file once.

        Raises:
            OSError: it cannot be read.
        """
        self.path = path
        self.topics: dict[int, tuple[str, str]] = {}
        self.counts: Counter[int] = Counter()
        self.begin_ns, self.end_ns = LATEST, -1
        self.problems: list[str] = []
        self.closed = self.broken = False
        self.whole = len(MCAP)
        self._blocks: list[_Block] = []
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[int, str]] = {}
        self._damage: Counter[str] = Counter()
        self._stated: int | None = None
        with path.open('rb') as stream:
            self._walk(stream, path.stat().st_size)
        for channel, (schema, topic) in self._channels.items():
            self.topics[channel] = topic, self._schemas.get(schema, '')
        count = sum(self.counts.values())
        if self._stated not in (None, count):
            self._damage[f'it should hold {self._stated} messages, and {count} were found'] += 1
        lost = sum(count for channel, count in self.counts.items() if channel not in self.topics)
        if lost:
            self._damage[f'{lost} messages are of no topic'] += 1
        self.problems += [f"'{printable(path.name)}': {what}, {count} times" if count > 1 else
                          f"'{printable(path.name)}': {what}"
                          for what, count in self._damage.items()]

    def messages(self, chosen: Collection[int], first: int, last: int) -> Iterator[Message]:
        """Yield the messages of some channels with first ≤ time < last [ns], in order of time."""
        blocks = [block for block in self._blocks if block.latest >= first
                  and block.earliest < last and not block.channels.isdisjoint(chosen)]
        with self.path.open('rb') as stream:
            parts = [self._messages_of(stream, block, set(chosen), first, last)
                     for block in blocks]
            # A part is unpacked when its turn comes. Where too many have their turn at once,
            # the file's order stays.
            merged = (heapq.merge(*parts, key=itemgetter(1)) if _together(blocks) < _MERGED
                      else chain.from_iterable(parts))
            for message in merged:
                if message[0] >= 0:
                    yield message

    def _messages_of(
        self, stream: BinaryIO, block: _Block, chosen: Collection[int], first: int, last: int,
    ) -> Iterator[Message]:
        yield -1, block.earliest, b''  # tells when its turn is
        data = _data(stream, block)
        rows = messages_in(data)[0]
        for time, channel, begin, end in rows[
                np.argsort(rows[:, 0], kind='stable')].tolist():
            if first <= time < last and channel in chosen:
                yield channel, time, data[begin:end]

    def _walk(self, stream: BinaryIO, size: int) -> None:
        """Find out where messages are, and of which topics."""
        loose: int | None = None
        for kind, begin, end in records(stream, size):
            self.whole, head = end, begin - HEAD.size
            if kind in (SCHEMA, CHANNEL, MESSAGE):
                loose = head if loose is None else loose
                if end - loose < _BLOCK:
                    continue
                head = end
            if loose is not None:
                self._take(stream, _Block(loose, head - loose, '', head - loose, 0))
                loose = None
            if kind == CHUNK:
                self._take_chunk(stream, begin, end)
            elif kind == STATISTICS and end - begin >= 8:
                stream.seek(begin)
                self._stated = struct.unpack('<Q', stream.read(8))[0]
            self.closed = kind == FOOTER
        if loose is not None:
            self._take(stream, _Block(loose, self.whole - loose, '', self.whole - loose, 0))
        if self.closed:
            return
        stream.seek(max(size - len(MCAP), 0))
        self.broken = self.whole < size and stream.read() == MCAP
        if self.broken:
            self._damage[f'damaged at byte {self.whole}; what follows is left out'] += 1
        else:
            self.problems.append('the bag was not closed: what the recorder had written is there')

    def _take_chunk(self, stream: BinaryIO, begin: int, end: int) -> None:
        stream.seek(begin)
        head = stream.read(min(end - begin, CHUNK_HEAD.size + 4 + 64))
        try:
            _, _, size_unpacked, checksum = CHUNK_HEAD.unpack_from(head)
            compression, at = text_at(head, CHUNK_HEAD.size)
            size = struct.unpack_from('<Q', head, at)[0]
        except (struct.error, UnicodeDecodeError, DamageError):
            self._damage['a chunk is damaged'] += 1
            return
        if begin + at + 8 + size > end:
            self._damage['a chunk is damaged'] += 1
            return
        self._take(stream, _Block(begin + at + 8, size, compression, size_unpacked, checksum))

    def _take(self, stream: BinaryIO, block: _Block) -> None:
        """Keep a block for `messages`, if it can be read."""
        try:
            data = _data(stream, block)
        except DamageError as error:
            self._damage[str(error)] += 1
            return
        rows, others, problem = messages_in(data)
        if problem:
            self._damage[problem] += 1
        for kind, begin, end in others:
            try:
                self._learn(kind, data[begin:end])
            except (struct.error, UnicodeDecodeError, DamageError):
                self._damage['the description of a topic is damaged'] += 1
        if len(rows):
            channels, counts = np.unique(rows[:, 1], return_counts=True)
            self.counts.update(dict(zip(channels.tolist(), counts.tolist())))
            earliest, latest = int(rows[:, 0].min()), int(rows[:, 0].max())
            self.begin_ns = min(self.begin_ns, earliest)
            self.end_ns = max(self.end_ns, latest)
            self._blocks.append(block._replace(
                earliest=earliest, latest=latest, channels=frozenset(channels.tolist())))

    def _learn(self, kind: int, content: bytes) -> None:
        """Take in a schema or a channel; the first of a number counts."""
        number = struct.unpack_from('<H', content)[0]
        if kind == SCHEMA:
            self._schemas.setdefault(number, printable(text_at(content, 2)[0]))
        else:
            schema = struct.unpack_from('<H', content, 2)[0]
            self._channels.setdefault(number, (schema, printable(text_at(content, 4)[0])))


def _data(stream: BinaryIO, block: _Block) -> bytes:
    """Return a block's bytes without compression.

    Raises:
        DamageError: they are not what they should be.
    """
    stream.seek(block.begin)
    data = stream.read(block.size)
    if block.compression:
        data = unpacked(data, block.compression, block.unpacked)
    if len(data) != block.unpacked or (block.checksum and zlib.crc32(data) != block.checksum):
        raise DamageError('a chunk is damaged')
    return data


def _together(blocks: list[_Block]) -> int:
    """Return the size of the blocks that have to be held at once to merge them [bytes]."""
    edges = sorted(edge for block in blocks for edge in (
        (block.earliest, 0, block.unpacked), (block.latest, 1, -block.unpacked)))
    held = most = 0
    for _, _, change in edges:
        held += change
        most = max(most, held)
    return most

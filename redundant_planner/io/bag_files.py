"""The files of a bag, MCAP or sqlite3, read without trust in what they say of themselves.

An index, a count or a size may be wrong: the recorder was killed, the disk failed, or somebody
made the file so. A file is therefore walked through record by record, whatever its index says,
and nothing is unpacked beyond a bound. What is damaged is left out and mentioned; the rest is
read.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Collection, Iterator
import heapq
from itertools import chain
from operator import itemgetter
from pathlib import Path
import sqlite3
import struct
import sys
from typing import BinaryIO, NamedTuple, Protocol
from urllib.parse import quote
import zlib

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import PlannerError
from redundant_planner.io.printable import printable

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

# A message: its channel, when it was recorded [ns], and its bytes.
Message = tuple[int, int, bytes]

_MCAP = b'\x89MCAP0\r\n'
_SQLITE = b'SQLite format 3\0'
_ZSTD = b'\x28\xb5\x2f\xfd'
# A record of an MCAP file: its kind and length, then its content.
_HEAD = struct.Struct('<BQ')
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
_STATISTICS, _DATA_END = 0x0B, 0x0F
# Of a message: channel, sequence number, time of recording and of publishing.
_MESSAGE_HEAD = struct.Struct('<HIQQ')
# Of a chunk: first and last time, size and checksum of what is packed in it.
_CHUNK_HEAD = struct.Struct('<QQQI')
# What ends an MCAP file without an index: DataEnd, and a Footer that points nowhere.
_END = (struct.pack('<BQI', _DATA_END, 4, 0) + struct.pack('<BQQQI', _FOOTER, 20, 0, 0, 0)
        + _MCAP)
# Records outside of chunks are read in blocks of this size [bytes].
_BLOCK = 1_000_000
# A packed chunk or message that unpacks to more than this was made to fill the memory [bytes].
_UNPACKED = 128_000_000
# So was a file that unpacks to more than this many times its size.
_FILE_RATIO = 1000
# Chunks whose times overlap are merged while all of them together are smaller [bytes].
_MERGED = 512_000_000
# ROS counts the seconds of a stamp in 32 bits: no message is recorded later [ns].
_LATEST = 2**31 * 10**9


class RecordingError(PlannerError):
    """A bag cannot be read, or lacks what was asked of it."""


class _DamageError(Exception):
    """A stretch of a file is not what it should be."""


class BagFile(Protocol):
    """A file with messages.

    Attributes:
        topics: channel → topic and type.
        counts: channel → messages.
        begin_ns, end_ns: of the first and the last message; begin_ns > end_ns without any.
        problems: what was left out.
    """

    topics: dict[int, tuple[str, str]]
    counts: Counter[int]
    begin_ns: int
    end_ns: int
    problems: list[str]

    def messages(self, chosen: Collection[int], first: int, last: int) -> Iterator[Message]:
        """Yield the messages of some channels with first ≤ time < last [ns], in order of time."""


def bag_files(path: Path, folder: Path) -> list[BagFile]:
    """Return the files of a bag in order of time, each walked through once.

    Args:
        path: the bag's folder or one of its files.
        folder: for what has to be unpacked.

    Raises:
        RecordingError: there is none that can be read.
    """
    if not path.exists():
        raise RecordingError(f"'{path}' is not a readable bag: there is no such file")
    try:
        files = storage_files(path)
        if not files:
            raise RecordingError(
                f"'{path}' is not a readable bag: the folder has no .mcap and no .db3 file")
        opened, refused = [], []
        for file in files:
            try:
                opened.append(_opened(file, folder))
            except RecordingError as error:
                refused.append(error)
    except OSError as error:
        raise RecordingError(f"'{path}' is not a readable bag: {error}") from None
    if not opened:
        raise refused[0]
    opened.sort(key=lambda file: file.begin_ns)
    opened[0].problems += [f'{error}; it is left out' for error in refused]
    return opened


def storage_files(path: Path) -> list[Path]:
    """Return the files of a bag with messages in them: those of its folder, or the one it is."""
    if not path.is_dir():
        return [path]
    found = sorted(file for ending in ('mcap', 'db3', 'mcap.zstd', 'db3.zstd')
                   for file in path.glob(f'*.{ending}') if file.is_file())
    # What `ros2 bag play` has unpacked lies beside what it was unpacked from.
    return [file for file in found if file.suffix != '.zstd' or file.with_suffix('') not in found]


def _opened(file: Path, folder: Path) -> BagFile:
    with file.open('rb') as stream:
        begin = stream.read(len(_SQLITE))
    if begin.startswith(_ZSTD):
        unpacked = folder / f'{len(list(folder.iterdir()))}_{file.stem}'
        problem = _unpack_file(file, unpacked)
        opened = _opened(unpacked, folder)
        opened.problems += [problem] if problem else []
        return opened
    if begin.startswith(_MCAP):
        return McapFile(file)
    if begin == _SQLITE:
        return SqliteFile(file)
    raise RecordingError(f"'{file}' is not a readable bag: " + (
        'it is neither MCAP nor sqlite3' if begin else 'the file is empty'))


def _unpack_file(file: Path, target: Path) -> str:
    """Unpack a file as far as it goes; return what was wrong with it."""
    limit = _FILE_RATIO * file.stat().st_size
    unpacker = zstd.ZstdDecompressor()
    with file.open('rb') as packed, target.open('wb') as whole:
        while not unpacker.eof:
            more = packed.read(_BLOCK) if unpacker.needs_input else b''
            if unpacker.needs_input and not more:
                return f"'{file.name}' was cut off, and is unpacked as far as it goes"
            try:
                whole.write(unpacker.decompress(more, max_length=_BLOCK))
            except zstd.ZstdError as error:
                return f"'{file.name}' is damaged, and unpacked as far as it goes: {error}"
            if whole.tell() > limit:
                return (f"'{file.name}' unpacks to more than {_FILE_RATIO} times its size: the "
                        'rest is left out')
    return ''


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
        self.begin_ns, self.end_ns = _LATEST, -1
        self.problems: list[str] = []
        self.closed = self.broken = False
        self.whole = len(_MCAP)
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
        rows = _messages_in(data)[0]
        for time, channel, begin, end in rows[
                np.argsort(rows[:, 0], kind='stable')].tolist():
            if first <= time < last and channel in chosen:
                yield channel, time, data[begin:end]

    def _walk(self, stream: BinaryIO, size: int) -> None:
        """Find out where messages are, and of which topics."""
        loose: int | None = None
        for kind, begin, end in _records(stream, size):
            self.whole, head = end, begin - _HEAD.size
            if kind in (_SCHEMA, _CHANNEL, _MESSAGE):
                loose = head if loose is None else loose
                if end - loose < _BLOCK:
                    continue
                head = end
            if loose is not None:
                self._take(stream, _Block(loose, head - loose, '', head - loose, 0))
                loose = None
            if kind == _CHUNK:
                self._take_chunk(stream, begin, end)
            elif kind == _STATISTICS and end - begin >= 8:
                stream.seek(begin)
                self._stated = struct.unpack('<Q', stream.read(8))[0]
            self.closed = kind == _FOOTER
        if loose is not None:
            self._take(stream, _Block(loose, self.whole - loose, '', self.whole - loose, 0))
        if self.closed:
            return
        stream.seek(max(size - len(_MCAP), 0))
        self.broken = self.whole < size and stream.read() == _MCAP
        if self.broken:
            self._damage[f'damaged at byte {self.whole}; what follows is left out'] += 1
        else:
            self.problems.append('the bag was not closed: what the recorder had written is there')

    def _take_chunk(self, stream: BinaryIO, begin: int, end: int) -> None:
        stream.seek(begin)
        head = stream.read(min(end - begin, _CHUNK_HEAD.size + 4 + 64))
        try:
            _, _, unpacked, checksum = _CHUNK_HEAD.unpack_from(head)
            compression, at = _text(head, _CHUNK_HEAD.size)
            size = struct.unpack_from('<Q', head, at)[0]
        except (struct.error, UnicodeDecodeError, _DamageError):
            self._damage['a chunk is damaged'] += 1
            return
        if begin + at + 8 + size > end:
            self._damage['a chunk is damaged'] += 1
            return
        self._take(stream, _Block(begin + at + 8, size, compression, unpacked, checksum))

    def _take(self, stream: BinaryIO, block: _Block) -> None:
        """Keep a block for `messages`, if it can be read."""
        try:
            data = _data(stream, block)
        except _DamageError as error:
            self._damage[str(error)] += 1
            return
        rows, others, problem = _messages_in(data)
        if problem:
            self._damage[problem] += 1
        for kind, begin, end in others:
            try:
                self._learn(kind, data[begin:end])
            except (struct.error, UnicodeDecodeError, _DamageError):
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
        if kind == _SCHEMA:
            self._schemas.setdefault(number, printable(_text(content, 2)[0]))
        else:
            schema = struct.unpack_from('<H', content, 2)[0]
            self._channels.setdefault(number, (schema, printable(_text(content, 4)[0])))


def _records(stream: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """Yield kind, begin and end of the content of every whole record of an MCAP file."""
    at = len(_MCAP)
    while at + _HEAD.size <= size:
        stream.seek(at)
        kind, length = _HEAD.unpack(stream.read(_HEAD.size))
        begin = at + _HEAD.size
        at = begin + length
        if not kind or at > size:  # a disk that failed leaves zeros
            return
        yield kind, begin, at
        if kind == _FOOTER:
            return


def _text(content: bytes, at: int) -> tuple[str, int]:
    """Return the text at an offset, and where it ends."""
    length = struct.unpack_from('<I', content, at)[0]
    end = at + 4 + length
    if end > len(content):
        raise _DamageError('a text is longer than its record')
    return content[at + 4:end].decode(), end


def _data(stream: BinaryIO, block: _Block) -> bytes:
    """Return a block's bytes without compression.

    Raises:
        _DamageError: they are not what they should be.
    """
    stream.seek(block.begin)
    data = stream.read(block.size)
    if block.compression:
        data = _unpacked(data, block.compression, block.unpacked)
    if len(data) != block.unpacked or (block.checksum and zlib.crc32(data) != block.checksum):
        raise _DamageError('a chunk is damaged')
    return data


def _unpacked(data: bytes, compression: str, most: int) -> bytes:
    """Unpack data that must not become longer than `most`.

    Raises:
        _DamageError: they do, or they are no such data.
    """
    if most > _UNPACKED:
        raise _DamageError(f'a chunk unpacks to {most} bytes; {_UNPACKED} at most are taken')
    if compression not in ('zstd', 'lz4'):
        raise _DamageError('a chunk is packed in a way that is not known')
    unpacker = zstd.ZstdDecompressor() if compression == 'zstd' else LZ4FrameDecompressor()
    try:
        unpacked: bytes = unpacker.decompress(data, max_length=most + 1)
    except (zstd.ZstdError, RuntimeError, EOFError):  # lz4's is a RuntimeError
        unpacked = b''
    if not unpacker.eof or len(unpacked) > most:
        raise _DamageError('a chunk is damaged')
    return unpacked


def _messages_in(
    data: bytes,
) -> tuple[npt.NDArray[np.uint64], list[tuple[int, int, int]], str]:
    """Return the records in a block.

    Returns:
        Of every message its time, channel, begin and end, (k, 4); of every schema and channel its
        kind, begin and end; and what was wrong.
    """
    found, others, problem, at = array('Q'), [], '', 0
    while at + _HEAD.size <= len(data):
        kind, length = _HEAD.unpack_from(data, at)
        begin = at + _HEAD.size
        at = begin + length
        if not kind or at > len(data):
            problem = 'a chunk is damaged after a while'
            break
        if kind == _MESSAGE and length >= _MESSAGE_HEAD.size:
            channel, _, time, _ = _MESSAGE_HEAD.unpack_from(data, begin)
            found.extend((time, channel, begin + _MESSAGE_HEAD.size, at))
        elif kind in (_SCHEMA, _CHANNEL):
            others.append((kind, begin, at))
    rows = np.array(found, np.uint64).reshape(-1, 4)
    possible = rows[:, 0] < _LATEST
    if not possible.all():
        problem, rows = 'messages of an impossible time are left out', rows[possible]
    return rows, others, problem


def _together(blocks: list[_Block]) -> int:
    """Return the size of the blocks that have to be held at once to merge them [bytes]."""
    edges = sorted(edge for block in blocks for edge in (
        (block.earliest, 0, block.unpacked), (block.latest, 1, -block.unpacked)))
    held = most = 0
    for _, _, change in edges:
        held += change
        most = max(most, held)
    return most


class SqliteFile:
    """A file of the sqlite3 storage: the tables topics and messages."""

    def __init__(self, path: Path) -> None:
        """Count what is in the file.

        Raises:
            RecordingError: it is no such file.
        """
        self.path = path
        self.topics: dict[int, tuple[str, str]] = {}
        self.counts: Counter[int] = Counter()
        self.begin_ns, self.end_ns = _LATEST, -1
        self.problems: list[str] = []
        self._sound = True
        try:
            self._database = self._opened()
            self._count()
        except sqlite3.Error as error:
            raise RecordingError(f"'{path}' is not a readable bag: {error}") from None

    def _opened(self) -> sqlite3.Connection:
        database = sqlite3.connect(
            f'file:{quote(str(self.path.resolve()))}?mode=ro&immutable=1', uri=True,
            check_same_thread=False)
        database.text_factory = lambda text: text.decode(errors='replace')
        if sys.version_info >= (3, 11):
            # Nothing in a file is longer than the file, whatever an expression makes of it.
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH,
                              max(self.path.stat().st_size, 1_000_000))
        database.execute('PRAGMA trusted_schema = OFF')
        # Without it sqlite refuses a file that was cut off; nothing is written either way.
        database.execute('PRAGMA writable_schema = ON')
        tables = {name for name, in database.execute(
            "SELECT name FROM sqlite_master WHERE type = 'table' AND sql NOT LIKE '%VIRTUAL%'")}
        if not {'topics', 'messages'} <= tables:
            raise RecordingError(
                f"'{self.path}' is not a readable bag: it has no tables 'topics' and 'messages'")
        return database

    def _count(self) -> None:
        for channel, topic, kind in self._database.execute('SELECT id, name, type FROM topics'):
            if isinstance(channel, int):
                self.topics[channel] = printable(str(topic)), printable(str(kind))
        impossible = 0
        try:
            for channel, time in self._database.execute(
                    'SELECT topic_id, timestamp FROM messages'):
                if _possible(channel, time):
                    self.counts[channel] += 1
                    self.begin_ns, self.end_ns = min(self.begin_ns, time), max(self.end_ns, time)
                else:
                    impossible += 1
        except sqlite3.Error as error:
            self._sound = False
            self.problems.append(f'the bag is damaged, and read as far as it goes: {error}')
        if impossible:
            self.problems.append(f'{impossible} messages of an impossible time are left out')

    def messages(self, chosen: Collection[int], first: int, last: int) -> Iterator[Message]:
        """Yield the messages of some channels with first ≤ time < last [ns], in order of time."""
        query = ('SELECT topic_id, timestamp, data FROM messages WHERE timestamp >= ? AND '
                 f'timestamp < ? AND topic_id IN ({",".join(str(channel) for channel in chosen)})')
        found = False
        # To sort them, all of them must be readable; if not, they come as they were written.
        for order in (' ORDER BY timestamp', '') if self._sound else ('',):
            try:
                for channel, time, raw in self._database.execute(
                        query + order, (first, min(last, _LATEST))):
                    if _possible(channel, time) and isinstance(raw, bytes):
                        found = True
                        yield channel, time, raw
                return
            except sqlite3.Error as error:
                problem = f'the bag is damaged, and read as far as it goes: {error}'
                self.problems += [problem] if problem not in self.problems else []
                if found:
                    return


def _possible(channel: object, time: object) -> bool:
    return isinstance(channel, int) and isinstance(time, int) and 0 <= time < _LATEST


def unpacked_message(raw: bytes) -> bytes:
    """Return a message as it was before the recorder packed it, if it did.

    Raises:
        RecordingError: it is damaged.
    """
    if not raw.startswith(_ZSTD):  # which no serialised message does
        return raw
    try:
        return _unpacked(raw, 'zstd', min(_UNPACKED, _FILE_RATIO * len(raw)))
    except _DamageError:
        raise RecordingError('it is packed, and damaged') from None


def close_mcap(file: Path) -> Path | None:
    """Cut off an incomplete last record and write the end of the file.

    Nothing is lost: what is cut off goes into a file beside it.

    Returns:
        That file, None if there was nothing to cut off.

    Raises:
        RecordingError: it is no MCAP file.
    """
    whole = McapFile(file).whole
    rest = None
    with file.open('r+b') as stream:
        stream.seek(whole)
        if stream.read(1):
            rest = file.with_name(f'{file.name}.rest')
            stream.seek(whole)
            with rest.open('xb') as target:
                while block := stream.read(_BLOCK):
                    target.write(block)
        stream.truncate(whole)
        stream.seek(whole)
        stream.write(_END)
    return rest


def repair(path: Path) -> list[str]:
    """Close a bag whose recorder was killed, where it is; return what was done, if anything.

    Raises:
        RecordingError: it is no MCAP bag, or it is damaged otherwise.
    """
    files = storage_files(path) if path.exists() else []
    if not files:
        raise RecordingError(f"'{path}' is not an MCAP bag")
    done = []
    for file in files:
        with file.open('rb') as stream:
            begin = stream.read(len(_MCAP))
        if begin != _MCAP:
            raise RecordingError(
                f"'{file}' is not an MCAP bag" + ('' if begin else ': the file is empty'))
        found = McapFile(file)
        if found.closed:
            continue
        if found.broken:
            raise RecordingError(f"'{file}' was closed, and is damaged at byte {found.whole}; "
                                 'analyze_bag reads what is sound')
        rest = close_mcap(file)
        done.append(f"'{file}' is closed now" + (
            f"; an incomplete last record is in '{rest}'" if rest else ''))
    return done

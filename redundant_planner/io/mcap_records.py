"""The records that an MCAP file consists of, each with its kind and length."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
import struct
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from redundant_planner.io.bag_storage import LATEST
from redundant_planner.io.unpacking import DamageError

MCAP = b'\x89MCAP0\r\n'
# A record of an MCAP file: its kind and length, then its content.
HEAD = struct.Struct('<BQ')
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
STATISTICS, _DATA_END = 0x0B, 0x0F
# Of a message: channel, sequence number, time of recording and of publishing.
_MESSAGE_HEAD = struct.Struct('<HIQQ')
# Of a chunk: first and last time, size and checksum of what is packed in it.
CHUNK_HEAD = struct.Struct('<QQQI')
# What ends an MCAP file without an index: DataEnd, and a Footer that points nowhere.
END = (struct.pack('<BQI', _DATA_END, 4, 0) + struct.pack('<BQQQI', FOOTER, 20, 0, 0, 0)
       + MCAP)


def records(stream: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """Yield kind, begin and end of the content of every whole record of an MCAP file."""
    at = len(MCAP)
    while at + HEAD.size <= size:
        stream.seek(at)
        kind, length = HEAD.unpack(stream.read(HEAD.size))
        begin = at + HEAD.size
        at = begin + length
        if not kind or at > size:  # a disk that failed leaves zeros
            return
        yield kind, begin, at
        if kind == FOOTER:
            return


def text_at(content: bytes, at: int) -> tuple[str, int]:
    """Return the text at an offset, and where it ends."""
    length = struct.unpack_from('<I', content, at)[0]
    end = at + 4 + length
    if end > len(content):
        raise DamageError('a text is longer than its record')
    return content[at + 4:end].decode(), end


def messages_in(
    data: bytes,
) -> tuple[npt.NDArray[np.uint64], list[tuple[int, int, int]], str]:
    """Return the records in a block.

    Returns:
        Of every message its time, channel, begin and end, (k, 4); of every schema and channel its
        kind, begin and end; and what was wrong.
    """
    found, others, problem, at = array('Q'), [], '', 0
    while at + HEAD.size <= len(data):
        kind, length = HEAD.unpack_from(data, at)
        begin = at + HEAD.size
        at = begin + length
        if not kind or at > len(data):
            problem = 'a chunk is damaged after a while'
            break
        if kind == MESSAGE and length >= _MESSAGE_HEAD.size:
            channel, _, time, _ = _MESSAGE_HEAD.unpack_from(data, begin)
            found.extend((time, channel, begin + _MESSAGE_HEAD.size, at))
        elif kind in (SCHEMA, CHANNEL):
            others.append((kind, begin, at))
    rows = np.array(found, np.uint64).reshape(-1, 4)
    possible = rows[:, 0] < LATEST
    if not possible.all():
        problem, rows = 'messages of an impossible time are left out', rows[possible]
    return rows, others, problem

"""What was packed with zstd or LZ4, unpacked up to a bound.

A recorder packs single messages, chunks of them, or whole files. A size that a file states may be
wrong, so nothing is unpacked beyond what is plausible.
"""

from __future__ import annotations

from pathlib import Path
import sys

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from redundant_planner.io.bag_storage import RecordingError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

# What a file or message begins with that zstd has packed.
ZSTD = b'\x28\xb5\x2f\xfd'
# A packed file is read in blocks of this size [bytes].
_BLOCK = 1_000_000
# A packed chunk or message that unpacks to more than this was made to fill the memory [bytes].
_UNPACKED = 128_000_000
# So was a file that unpacks to more than this many times its size.
_FILE_RATIO = 1000


class DamageError(Exception):
    """A stretch of a file is not what it should be."""


def unpack_file(file: Path, target: Path) -> str:
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


def unpacked(data: bytes, compression: str, most: int) -> bytes:
    """Unpack data that must not become longer than `most`.

    Raises:
        DamageError: it does, or it is no such data.
    """
    if most > _UNPACKED:
        raise DamageError(f'a chunk unpacks to {most} bytes; {_UNPACKED} at most are taken')
    if compression not in ('zstd', 'lz4'):
        raise DamageError('a chunk is packed in a way that is not known')
    unpacker = zstd.ZstdDecompressor() if compression == 'zstd' else LZ4FrameDecompressor()
    try:
        unpacked: bytes = unpacker.decompress(data, max_length=most + 1)
    except (zstd.ZstdError, RuntimeError, EOFError):  # lz4's is a RuntimeError
        unpacked = b''
    if not unpacker.eof or len(unpacked) > most:
        raise DamageError('a chunk is damaged')
    return unpacked


def unpacked_message(raw: bytes) -> bytes:
    """Return a message as it was before the recorder packed it, if it did.

    Raises:
        RecordingError: it is damaged.
    """
    if not raw.startswith(ZSTD):  # which no serialised message does
        return raw
    try:
        return unpacked(raw, 'zstd', min(_UNPACKED, _FILE_RATIO * len(raw)))
    except DamageError:
        raise RecordingError('it is packed, and damaged') from None

"""The folder that keeps machine code: this version's alone, the user's alone, under checksums."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
from pathlib import Path
import shutil
import stat
import zlib

from redundant_planner.core.cache_folder import cache_folder


@functools.cache
def machine_code_folder(wish: str, how: str) -> Path | None:
    """Return this version's folder, with nothing in it that is damaged; None if there is none.

    Args:
        wish: where NUMBA_CACHE_DIR wants it; empty for no wish.
        how: it is compiled, as the end of a name: what is compiled otherwise lies elsewhere.
    """
    here = Path(__file__).parent
    sources = b''.join(path.read_bytes() for path in sorted(here.rglob('*.py')))
    version = f'compiled-{zlib.crc32(sources):08x}'
    name = version + how
    beside = here / '__pycache__'
    # Nobody else keeps anything here: what is left is of other versions.
    for other in beside.glob('compiled-*'):
        if not other.name.startswith(version):
            shutil.rmtree(other, ignore_errors=True)
    wished = [Path(wish)] if wish else []
    for parent in (*wished, beside, cache_folder()):
        if parent is not None and is_private(parent / name):
            drop_damaged(parent / name)
            return parent / name
    return None


def is_private(folder: Path) -> bool:
    """Make a folder; return whether it is there and nobody but this user can write to it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
    except OSError:
        return False
    return (status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
            and os.access(folder, os.W_OK))


# Numba runs whatever it finds in its files. Beside each of them lies its checksum.
_SEAL = '.sum'
_KEPT = ('*.nbi', '*.nbc')


def seal(folder: Path, part: str) -> None:
    """Write the checksums of a folder's files that have `part` in their name."""
    for file in (file for kind in _KEPT for file in folder.glob(kind) if part in file.name):
        with contextlib.suppress(OSError):  # another process has just replaced it
            beside = file.with_name(f'{file.name}{_SEAL}.{os.getpid()}')
            beside.write_text(_checksum(file))
            beside.replace(file.with_name(file.name + _SEAL))


def drop_damaged(folder: Path) -> None:
    """Delete the files below a folder that are not as they were written: cut, empty, altered."""
    for file in (file for kind in _KEPT for file in folder.rglob(kind)):
        try:
            sound = file.with_name(file.name + _SEAL).read_text() == _checksum(file)
        except (OSError, ValueError):
            sound = False
        if not sound:
            with contextlib.suppress(OSError):
                file.unlink()


def _checksum(file: Path) -> str:
    return hashlib.blake2b(file.read_bytes()).hexdigest()

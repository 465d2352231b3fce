"""The folder that keeps machine code: this version's alone, the user's alone, under checksums."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
from pathlib import Path
import re
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
    version = f'compiled-{zlib.crc32(compiled_sources(here)):08x}'
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


# What marks a function that is compiled (`kernels`), and what a module takes from others of core.
_MARKS = re.compile(r'^@(?:compiled|kernel|entry)$', re.MULTILINE)
_IMPORTS = re.compile(
    r'^ *from redundant_planner\.core([\w.]*) import (\([^)]*\)|.*)$', re.MULTILINE)


def compiled_sources(core: Path) -> bytes:
    """Return the sources that machine code is made of, one after another.

    Those are the files below a folder that define compiled functions, and all that these import,
    directly or not: constants are part of the machine code, too. Other files can change without
    anything being compiled again.
    """
    texts = {path: path.read_text() for path in sorted(core.rglob('*.py'))}
    found = {path for path, text in texts.items() if _MARKS.search(text)}
    unread = list(found)
    while unread:
        for dots, names in _IMPORTS.findall(texts[unread.pop()]):
            module = core.joinpath(*dots.strip('.').split('.'))
            # `from core.robot import se3` names a file, `from core.robot.se3 import Pose` is one.
            files = [module.with_suffix('.py') if module != core else core / '__init__.py',
                     *(module / f'{name}.py' for name in re.findall(r'\w+', names))]
            new = [file for file in files if file in texts and file not in found]
            found.update(new)
            unread += new
    return ''.join(texts[path] for path in sorted(found)).encode()


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

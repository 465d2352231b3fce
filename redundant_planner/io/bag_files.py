"""The files of a bag, MCAP or sqlite3, read without trust in what they say of themselves.

An index, a count or a size may be wrong: the recorder was killed, the disk failed, or somebody
made the file so. A file is therefore walked through record by record, whatever its index says,
and nothing is unpacked beyond a bound. What is damaged is left out and mentioned; the rest is
read.
"""

from __future__ import annotations

from pathlib import Path

from redundant_planner.io.bag_storage import BagFile, RecordingError
from redundant_planner.io.mcap_file import McapFile
from redundant_planner.io.mcap_records import MCAP
from redundant_planner.io.sqlite_file import SQLITE, SqliteFile
from redundant_planner.io.unpacking import unpack_file, ZSTD


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
        begin = stream.read(len(SQLITE))
    if begin.startswith(ZSTD):
        unpacked = folder / f'{len(list(folder.iterdir()))}_{file.stem}'
        problem = unpack_file(file, unpacked)
        opened = _opened(unpacked, folder)
        opened.problems += [problem] if problem else []
        return opened
    if begin.startswith(MCAP):
        return McapFile(file)
    if begin == SQLITE:
        return SqliteFile(file)
    raise RecordingError(f"'{file}' is not a readable bag: " + (
        'it is neither MCAP nor sqlite3' if begin else 'the file is empty'))

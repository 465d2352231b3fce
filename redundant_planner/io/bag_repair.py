"""Closes a bag whose recorder was killed."""

from __future__ import annotations

from pathlib import Path

from redundant_planner.io.bag_files import storage_files
from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.mcap_file import McapFile
from redundant_planner.io.mcap_records import END, MCAP

# What is cut off is copied in blocks of this size [bytes].
_BLOCK = 1_000_000


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
            begin = stream.read(len(MCAP))
        if begin != MCAP:
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
        stream.write(END)
    return rest

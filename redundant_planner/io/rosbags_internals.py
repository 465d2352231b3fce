"""All private parts of rosbags that this package uses, each with what happens without it.

Tested with rosbags 0.11.
"""

from __future__ import annotations

from rosbags.rosbag2 import Writer


def write_pending_chunk(writer: Writer) -> None:
    """Hand the messages that a writer of MCAP still holds to the system.

    rosbags does so only when a chunk is full. Where it keeps its chunk elsewhere, or with another
    storage, nothing happens: messages then wait for a full chunk or the end of the bag.
    """
    storage = getattr(writer, 'storage', None)
    chunk = getattr(storage, 'chunk', None)
    close_chunk, file = getattr(storage, 'close_chunk', None), getattr(storage, 'bio', None)
    if getattr(chunk, 'msgs', None) and close_chunk is not None and file is not None:
        close_chunk()
        file.flush()

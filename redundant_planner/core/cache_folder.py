"""Where this user's caches lie, if there is a place that nobody else can write to."""

from __future__ import annotations

import os
from pathlib import Path
import stat


def cache_folder() -> Path | None:
    """Return $XDG_CACHE_HOME/redundant_planner, or ~/.cache/redundant_planner; made if missing.

    None where there is no such folder that belongs to this user and that nobody else can write
    to: then nothing is to be kept, for what others can change must not be believed.
    """
    caches = Path(os.environ.get('XDG_CACHE_HOME', ''))
    if not caches.is_absolute():
        home = Path(os.path.expanduser('~'))
        # Without HOME and an entry in the user database '~' stays as it is.
        if not (home.is_absolute() and home.is_dir()):
            return None
        caches = home / '.cache'
    folder = caches / 'redundant_planner'
    try:
        caches.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.stat()
    except (OSError, ValueError):
        return None
    theirs = stat.S_IWGRP | stat.S_IWOTH
    private = status.st_uid == os.getuid() and not status.st_mode & theirs
    return folder if private and os.access(folder, os.W_OK | os.X_OK) else None

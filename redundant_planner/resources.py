"""Where the package's files lie: installed by colcon, by pip, or in a source checkout."""

from __future__ import annotations

import os
from pathlib import Path
import sys

from redundant_planner.core.errors import known, PlannerError

PACKAGE = 'redundant_planner'


def share_directory() -> Path:
    """Return the folder that holds config/ and launch/."""
    here = Path(__file__).resolve().parent
    candidates = [here.parent]  # a checkout or an editable install
    # pip: <prefix>/share; colcon: <install>/lib/pythonX.Y/site-packages/redundant_planner
    candidates += [prefix / 'share' / PACKAGE for prefix in (*here.parents, Path(sys.prefix))]
    for candidate in candidates:
        if (candidate / 'config').is_dir() and (candidate / 'package.xml').is_file():
            return candidate
    raise PlannerError(f"the '{PACKAGE}' configuration files are missing from this installation")


def resolve(location: str, relative_to: Path | None = None) -> Path:
    """Return the file that a location names.

    Args:
        location: a path, `file://` path or `package://name/path`; the package may be one that
            `relative_to` lies in, or one that is installed.
        relative_to: folder for relative paths; the working directory if not given.

    Raises:
        PlannerError: there is no such file or package.
    """
    if location.startswith('package://'):
        package, _, rest = location[len('package://'):].partition('/')
        path = _beside(package, rest, relative_to) or _package_share(package) / rest
    else:
        path = Path(location.removeprefix('file://')).expanduser()
        if not path.is_absolute() and relative_to is not None:
            path = relative_to / path
    if not path.is_file():
        raise PlannerError(f"'{location}' is not a file" + (
            f" (looked at '{path}')" if str(path) != location else ''))
    return path


def _beside(package: str, rest: str, folder: Path | None) -> Path | None:
    """Return a package's file if the folder lies in that package, installed or not."""
    for above in (folder, *folder.parents) if folder is not None else ():
        if above.name == package and (above / rest).is_file():
            return above / rest
    return None


def _package_share(package: str) -> Path:
    if package == PACKAGE:
        return share_directory()
    prefixes = [p for p in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if p]
    for prefix in prefixes:
        share = Path(prefix) / 'share' / package
        if share.is_dir():
            return share
    raise PlannerError(f"package '{package}' is not installed; looked below {known(prefixes)} "
                       '(AMENT_PREFIX_PATH); source its workspace or give a file path')

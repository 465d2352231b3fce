"""Where the package's files lie: installed by colcon, by pip, or in a source checkout."""

from __future__ import annotations

import os
from pathlib import Path
import sys
import sysconfig
from typing import Any

import yaml

from redundant_planner.core.errors import known, PlannerError, shown

PACKAGE = 'redundant_planner'
# A larger file is neither a URDF nor made of parameters [bytes].
_LARGEST_FILE = 20_000_000
_PANDA_URDFS = (
    'package://moveit_resources_panda_description/urdf/panda.urdf',
    # Where pip puts example-robot-data.
    f'{sysconfig.get_paths()["purelib"]}/cmeel.prefix/share/example-robot-data/robots/'
    'panda_description/urdf/panda.urdf',
)


def share_directory() -> Path:
    """Return the folder that holds config/ and launch/."""
    here = Path(__file__).resolve().parent.parent
    candidates = [here.parent]  # a checkout or an editable install
    # pip: <prefix>/share; colcon: <install>/lib/pythonX.Y/site-packages/redundant_planner
    candidates += [prefix / 'share' / PACKAGE for prefix in (*here.parents, Path(sys.prefix))]
    for candidate in candidates:
        if (candidate / 'config').is_dir() and (candidate / 'package.xml').is_file():
            return candidate
    raise PlannerError(f"the '{PACKAGE}' configuration files are missing from this installation")


def resolve(location: str, relative_to: Path | None = None) -> Path:
    """Return the file that a location names, as an absolute path.

    Args:
        location: a path, `file://` path or `package://name/path`; the package may be one that
            `relative_to` lies in, one that is installed, or a folder next to `relative_to` or
            above it.
        relative_to: folder for relative paths; the working directory if not given.

    Raises:
        PlannerError: there is no such file or package.
    """
    try:
        if location.startswith('package://'):
            package, _, rest = location[len('package://'):].partition('/')
            path = _package_file(package, rest, relative_to)
        else:
            path = Path(location.removeprefix('file://')).expanduser()
            if not path.is_absolute() and relative_to is not None:
                path = relative_to / path
        # Meshes are looked up from here, and files that name it are read from elsewhere.
        path = path.absolute()
        found = path.is_file()
    except (OSError, RuntimeError) as error:  # too long, or the home of nobody
        reason = error.strerror if isinstance(error, OSError) else error
        raise PlannerError(f'{shown(location)} cannot be looked up: {reason}') from None
    if not found:
        raise PlannerError(f'{shown(location)} is not a file' + (
            f" (looked at '{path}')" if str(path) != location else ''))
    return path


def read_text(path: Path) -> str:
    """Return a file's text.

    Raises:
        PlannerError: it cannot be read, is not UTF-8, or is far too large.
    """
    try:
        with path.open('rb') as file:
            content = file.read(_LARGEST_FILE + 1)
        if len(content) > _LARGEST_FILE:
            raise PlannerError(f"'{path}' is larger than {_LARGEST_FILE} bytes")
        return content.decode()
    except OSError as error:
        raise PlannerError(f"'{path}' cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise PlannerError(f"'{path}' is not UTF-8 text") from None


def yaml_content(text: str, what: str) -> Any:
    """Return the content of YAML text.

    Args:
        text: to read.
        what: it is, for the message.

    Raises:
        PlannerError: it is not YAML.
    """
    try:
        return yaml.safe_load(text)
    # What looks like a date, say, but is none is a ValueError of PyYAML's.
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        words = ' '.join(str(error).split())
        raise PlannerError(f'{what} is not valid YAML: {words[:300]}') from None


def _package_file(package: str, rest: str, folder: Path | None) -> Path:
    """Return a package's file: of the package that the folder lies in, installed, or next to it.

    Raises:
        PlannerError: there is no such package.
    """
    above: list[Path] = []
    if folder is not None:
        # As it was named, and where links and '..' lead.
        above = [parent for path in (folder.absolute(), folder.resolve())
                 for parent in (path, *path.parents)]
    inside = next((parent / rest for parent in above
                   if parent.name == package and (parent / rest).is_file()), None)
    if inside is not None:
        return inside
    beside = next((parent / package / rest for parent in above
                   if (parent / package / rest).is_file()), None)
    try:
        installed = _package_share(package) / rest
    except PlannerError:
        if beside is not None:
            return beside
        raise
    return installed if installed.is_file() or beside is None else beside


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


def panda_urdf() -> Path | None:
    """Return the first URDF of a Panda that this machine has."""
    for location in _PANDA_URDFS:
        try:
            return resolve(location)
        except PlannerError:
            continue
    return None

"""ROS packages of others: whether they are installed, and the line that installs them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import os
from pathlib import Path

from redundant_planner.core.errors import PlannerError


def check_installed(
    what: str, packages: Iterable[str], environment: Mapping[str, str] = os.environ,
) -> None:
    """Look for packages that something takes.

    Args:
        what: takes them, for the message.
        packages: their names.
        environment: with AMENT_PREFIX_PATH, where they are looked for.

    Raises:
        PlannerError: packages are missing; the message has the line that installs them.
    """
    prefixes = environment.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    missing = [package for package in packages if not any(
        Path(prefix, 'share', package).is_dir() for prefix in prefixes if prefix)]
    if missing:
        raise PlannerError(f'{what} needs packages that are not installed: '
                           f'{apt_line(missing, environment)}')


def apt_line(packages: Iterable[str], environment: Mapping[str, str] = os.environ) -> str:
    """Return the command that installs ROS packages."""
    distribution = environment.get('ROS_DISTRO') or 'jazzy'
    return ' '.join(['sudo apt install', *(f"ros-{distribution}-{package.replace('_', '-')}"
                                           for package in packages)])

"""URDFs as files have them: as they are, or as xacro macros that are expanded first."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import re

from redundant_planner.core.errors import known, PlannerError, shown
from redundant_planner.io.resources import read_text, resolve

# An argument that a file of macros declares.
_ARGUMENT = re.compile(r'<xacro:arg\s+name="([^"]+)"')
# What ament says of a package that `$(find …)` asks for and that is not there.
_MISSING = re.compile(r'"?package \'([^\']+)\' not found')
# Where sourced workspaces are.
_SOURCED = 'AMENT_PREFIX_PATH'


def is_xacro(path: Path) -> bool:
    """Return whether a file is one of macros, by its name."""
    return path.suffix == '.xacro'


def urdf_in(path: Path, arguments: Sequence[str] = ()) -> str:
    """Return the URDF's text in a file, expanded where it is one of macros.

    Args:
        path: of the file.
        arguments: for the macros, each 'name:=value' as xacro itself takes them.

    Raises:
        PlannerError: it cannot be read or expanded, an argument is malformed, or there are macros
            and no xacro.
    """
    text = read_text(path)
    if not is_xacro(path):
        if arguments:
            raise PlannerError(f"'{path}' is no xacro file, so it takes no arguments for one")
        return text
    mappings = {}
    for argument in arguments:
        name, separator, value = argument.partition(':=')
        if not (name and separator):
            raise PlannerError(f'xacro argument {shown(argument)} is not of the form name:=value')
        mappings[name] = value
    try:
        import xacro
    except ImportError:
        line = ' '.join(('xacro', str(path), *arguments, '>', path.name.removesuffix('.xacro')))
        raise PlannerError(
            f"'{path}' is a xacro file, and there is no xacro to expand it: install "
            f'ros-jazzy-xacro, pip install xacro, or run `{line}` where it is') from None
    try:
        return str(xacro.process_file(str(path), mappings=dict(mappings)).toxml())
    except Exception as error:  # xacro's own, XML's, and whatever an expression in it raises
        taken = [name for name in _ARGUMENT.findall(text) if name not in mappings]
        raise PlannerError(f"xacro cannot expand '{path}': {_reason(error)}" + (
            f'; arguments that it takes besides: {known(taken)}' if taken else '')) from None


def _reason(error: Exception) -> str:
    """Return why a file cannot be expanded; xacro's own words come twice, or with a class."""
    cause = getattr(error, 'exc', None) or error
    found = _MISSING.match(str(cause))
    if found:
        return f"package '{found[1]}' is not installed; source the workspace that has it"
    if _SOURCED in str(cause):
        return f'it asks for a package, and no workspace is sourced ({_SOURCED} is not set)'
    return str(error.args[0] if isinstance(cause, OSError) and error.args else error)


def expanded(urdf: str, arguments: Sequence[str], folder: Path) -> str:
    """Return where a URDF is: where it was, or where its macros have been expanded to.

    Args:
        urdf: path, file:// or package:// location.
        arguments: for the macros, see `urdf_in`.
        folder: that the expanded file is written to, under the same name without `.xacro`.

    Raises:
        PlannerError: as `urdf_in`, or the file cannot be written.
    """
    path = resolve(urdf)
    if not (is_xacro(path) or arguments):
        return urdf
    text = urdf_in(path, arguments)
    file = (folder / path.stem).with_suffix('.urdf').absolute()
    try:
        file.write_text(text, encoding='utf-8')
    except OSError as error:
        raise PlannerError(f"the expanded '{file}' cannot be written: {error.strerror}") from None
    return str(file)

"""Parameters that a node was given more than once, where rcl does not let the last one hold."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import functools
from itertools import pairwise
from pathlib import Path
import re
from typing import Any

import yaml


class _Untagged(yaml.SafeLoader):
    """Reads YAML as rcl does, which looks at no tags: launch_ros writes lists as Python tuples."""

    def value_of(self, tag: str, node: yaml.Node) -> Any:
        """Return what stands behind a tag that YAML itself does not know."""
        if isinstance(node, yaml.SequenceNode):
            return self.construct_sequence(node, deep=True)
        if isinstance(node, yaml.MappingNode):
            return self.construct_mapping(node, deep=True)
        return node.value


_Untagged.add_multi_constructor('', _Untagged.value_of)


@functools.cache
def disputed(arguments: tuple[str, ...], node: str) -> dict[str, Any]:
    """Return the parameters that the command line and its files give more than once.

    The last one holds, and one of -p before those of files. rcl decides otherwise: of several
    types a whole number wins over a decimal one, whatever their order, and a section with the
    node's own name over -p.

    Args:
        arguments: of the process.
        node: its full name.

    Returns:
        Name → value, of those alone that rcl may decide otherwise.
    """
    files: dict[str, list[Any]] = {}
    lines: dict[str, list[Any]] = {}
    inside = False
    for flag, argument in pairwise((*arguments, '')):
        inside = flag == '--ros-args' or (inside and flag != '--')
        if inside and flag == '--params-file':
            content = yaml.load(Path(argument).read_text(), _Untagged)
            for name, value in _values_for(node, content):
                files.setdefault(name, []).append(value)
        elif inside and flag in ('-p', '--param'):
            name, _, text = argument.partition(':=')
            place, colon, name = name.rpartition(':')
            if not colon or place == node.rpartition('/')[2]:
                lines.setdefault(name, []).append(_plain(yaml.load(text, _Untagged)))
    last = {name: values[-1] for name, values in (files | lines).items()}
    return {name: value for name, value in last.items()
            if (name in files and name in lines) or len(
                {_kind(given) for given in (files | lines)[name]}) > 1}


def _values_for(node: str, content: Any, place: str = '') -> Iterator[tuple[str, Any]]:
    """Yield what a parameter file gives a node, from its sections in their order."""
    for key, value in content.items() if isinstance(content, dict) else ():
        if key == 'ros__parameters':
            pattern = re.escape(place).replace(r'/\*\*', r'(/[^/]+)*').replace(r'\*', '[^/]+')
            if re.fullmatch(pattern, node):
                yield from _flat(value)
        else:
            yield from _values_for(node, value, f'{place}/{str(key).strip("/")}')


def _flat(content: Any, prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield nested names joined by dots."""
    for key, value in content.items() if isinstance(content, dict) else ():
        if isinstance(value, dict):
            yield from _flat(value, f'{prefix}{key}.')
        else:
            yield f'{prefix}{key}', _plain(value)


def _kind(value: Any) -> str:
    """Return what rcl tells values apart by."""
    return f'list of {type(value[0])}' if isinstance(value, list) and value else str(type(value))


def _plain(value: Any) -> Any:
    """Return a value as rcl reads it: 1e5 is a number for it, for PyYAML a string."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, str):
        with contextlib.suppress(ValueError):
            return float(value)
    return value

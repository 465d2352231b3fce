"""Draws docs/architecture.svg from the code's own imports, and lists them in the page beside it.

Run `python -m redundant_planner.tools.draw_architecture` after a change of imports between rooms.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Mapping
from pathlib import Path
import re
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from redundant_planner.analysis.style import BLUE_FILL, INK, LIMIT_COLOR, MUTED, SAND_FILL, styled

PACKAGE = 'redundant_planner'
_SOURCE = Path(__file__).resolve().parent.parent
_DOCS = _SOURCE.parent / 'docs'
_BEGIN, _END = '<!-- imports, by draw_architecture -->', '<!-- end of imports -->'

# The message's way through the rooms, and what each holds; the arrows come from the code.
_STEPS = ('cmd_vel,\njoint_states,\nobstacles', 'nodes, io:\nread the bytes',
          'core: aim\nand wish', 'core/safety:\nkeep it safe', 'io, nodes:\nwrite the bytes',
          'joint_command')
_HOLDS = {
    'tools': 'one command per file',
    'playground': 'a page to try it (viser)',
    'nodes': 'topics, clocks, pauses (rclpy)',
    'paper': "the paper's experiment",
    'analysis': 'measures, figures, report',
    'perception': "clouds, MoveIt's scene, a camera",
    'physics': 'an arm with mass, MuJoCo',
    'simulation.py': 'planner and ideal arm',
    'io': 'messages, bags, robot files',
    'core': 'Planner.step, the composition',
    'core/target': 'the way to a pose',
    'core/horizon': 'the joint path ahead',
    'core/safety': 'limits, braking, the QP',
    'core/obstacles': 'shapes, clearance, what is near',
    'core/redundancy': 'J⁺, P, the criteria of ∇H',
    'core/robot': 'model, kinematics, capsules',
}
# Left and lower edge of each room's box. A room may import those that stand lower.
_PLACES = {
    'tools': (1.9, 7.15), 'playground': (0.6, 6.75), 'nodes': (0.15, 6.0), 'paper': (2.85, 5.6),
    'analysis': (1.5, 5.1), 'perception': (0.15, 5.1),
    'physics': (2.85, 4.85), 'simulation.py': (2.0, 4.2), 'io': (0.85, 4.2),
    'core': (1.5, 3.0), 'core/target': (0.1, 2.7), 'core/horizon': (0.85, 2.1),
    'core/safety': (2.85, 2.1),
    'core/obstacles': (0.15, 1.2), 'core/redundancy': (1.7, 1.2), 'core/robot': (0.85, 0.3),
}
# Around the rooms of the core: left, lower edge, width, height.
_CORE_FRAME = (0.0, 0.12, 3.9, 3.62)
_WIDTH, _HEIGHT = 0.9, 0.52
# What every room may use.
_COMMON = tuple(f'{PACKAGE}.core.{name}' for name in (
    'kernels', 'machine_code', 'errors', 'numbers', 'constants', 'parameters'))


def room_of(module: str) -> str | None:
    """Return the room that a module of this package is in; None for what belongs to none.

    The package itself, a single file such as `compile`, and what every room may use belong to
    none.
    """
    parts = module.split('.')[1:]
    if not parts or module.startswith(_COMMON):
        return None
    for room in ('/'.join(parts[:2]), parts[0], f'{parts[0]}.py'):
        if room in _HOLDS:
            return room
    return None


def room_imports(source: Path = _SOURCE) -> dict[str, tuple[str, ...]]:
    """Return room → the rooms that it imports, sorted, from every import statement.

    Args:
        source: the package's folder.
    """
    found: dict[str, set[str]] = {room: set() for room in _HOLDS}
    for path in sorted(source.rglob('*.py')):
        module = '.'.join((PACKAGE, *path.relative_to(source).with_suffix('').parts))
        room = room_of(module)
        if room is None:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            names = ([alias.name for alias in node.names] if isinstance(node, ast.Import)
                     else [node.module or ''] if isinstance(node, ast.ImportFrom) else [])
            found[room] |= {other for name in names if name.startswith(PACKAGE)
                            for other in [room_of(name)] if other not in (None, room)}
    return {room: tuple(sorted(others)) for room, others in found.items()}


def table(imports: Mapping[str, tuple[str, ...]]) -> str:
    """Return the imports as Markdown."""
    rows = [f'| `{room}` | {_HOLDS[room]} | {", ".join(f"`{o}`" for o in others) or "none"} |'
            for room, others in imports.items()]
    return '\n'.join(['| room | holds | imports |', '|---|---|---|', *rows])


def page_with(page: str, imports: Mapping[str, tuple[str, ...]]) -> str:
    """Return the page with its list of imports replaced."""
    return re.sub(f'{_BEGIN}.*?{_END}', lambda _: f'{_BEGIN}\n{table(imports)}\n{_END}', page,
                  flags=re.S)


def drawn_arrows(imports: Mapping[str, tuple[str, ...]]) -> list[tuple[str, str]]:
    """Return the imports that are drawn.

    An import from a room outside the core is one of the core as a whole. Left out are imports
    into the core, within it and by the tools that follow from others.
    """
    pairs = set()
    for room, others in imports.items():
        for other in others:
            to_core = other.startswith('core') and not room.startswith('core')
            pairs.add((room, 'core' if to_core else other))
    down = {(a, b) for a, b in pairs if _PLACES[a][1] > _PLACES[b][1]}
    below = {room: {b for a, b in down if a == room} for room in _PLACES}
    reached = dict(below)
    for room in sorted(_PLACES, key=lambda r: _PLACES[r][1]):
        reached[room] = below[room].union(*(reached[b] for b in below[room]))
    hidden = {(a, b) for a, b in down if any(b in reached[c] for c in below[a] - {b})
              and (a == 'tools' or a.startswith('core') or b == 'core')}
    return sorted(pairs - hidden)


@styled
def draw(path: Path, imports: Mapping[str, tuple[str, ...]]) -> None:
    """Write the picture: the way of a message above, the rooms and their imports below.

    Args:
        path: SVG or PNG file.
        imports: from `room_imports`.
    """
    matplotlib.rcParams['svg.hashsalt'] = PACKAGE  # the same file every time
    figure = Figure(figsize=(9.0, 9.0))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-0.15, 4.05), ylim=(0.0, 8.7))
    axes.set_axis_off()
    width = 3.9 / len(_STEPS)
    for i, step in enumerate(_STEPS):
        left = i * width + 0.05
        color = ('white' if i in (0, len(_STEPS) - 1)
                 else BLUE_FILL if step.startswith('core') else SAND_FILL)
        _box(axes, (left, 7.85, width - 0.1, 0.62), step, color)
        if i:
            axes.add_patch(FancyArrowPatch((left - 0.1, 8.16), (left, 8.16), arrowstyle='-|>',
                                           mutation_scale=12, color=INK, shrinkA=0, shrinkB=0))
    _box(axes, _CORE_FRAME, '', '#f5f9fc')
    for room, other in drawn_arrows(imports):
        _arrow(axes, room, other)
    for room, place in _PLACES.items():
        color = BLUE_FILL if room.startswith('core') else SAND_FILL
        _box(axes, (*place, _WIDTH, _HEIGHT), room, color, _HOLDS[room])
    metadata = {'Date': None} if path.suffix == '.svg' else None
    figure.savefig(path, metadata=metadata)


def _box(
    axes: Any, place: tuple[float, float, float, float], title: str, color: str, below: str = '',
) -> None:
    left, low, width, height = place
    axes.add_patch(FancyBboxPatch(
        (left, low), width, height, boxstyle='round,pad=0,rounding_size=0.06', facecolor=color,
        edgecolor=INK, linewidth=1.0, zorder=2.0 if title else 0.0))
    middle = low + (0.66 if below else 0.5) * height
    axes.text(left + 0.5 * width, middle, title, ha='center', va='center', zorder=3.0,
              fontsize=11.0 if below else 8.5, fontweight='bold' if below else 'normal',
              color=INK)
    axes.text(left + 0.5 * width, low + 0.28 * height, below, ha='center', va='center',
              fontsize=7.0, color=INK, zorder=3.0)


def _arrow(axes: Any, room: str, other: str) -> None:
    """Draw an arrow from one box to another; red where it leads upwards or sideways."""
    begin, end = _PLACES[room], _PLACES[other]
    down = begin[1] > end[1]
    shift = 0.25 * max(-1.0, min(1.0, end[0] - begin[0])) + (0.0 if down else 0.2)
    start = (begin[0] + (0.5 + shift) * _WIDTH, begin[1] + (0.0 if down else _HEIGHT))
    stop = (end[0] + (0.5 - shift) * _WIDTH, end[1] + (_HEIGHT if down else 0.0))
    if begin[1] == end[1]:
        right = end[0] > begin[0]
        start = (begin[0] + (_WIDTH if right else 0.0), begin[1] + 0.3 * _HEIGHT)
        stop = (end[0] + (0.0 if right else _WIDTH), end[1] + 0.3 * _HEIGHT)
    if other == 'core' and not room.startswith('core'):
        stop = (start[0], _CORE_FRAME[1] + _CORE_FRAME[3])
    axes.add_patch(FancyArrowPatch(
        start, stop, arrowstyle='-|>', mutation_scale=12, color=MUTED if down else LIMIT_COLOR,
        linewidth=1.1, shrinkA=0.0, shrinkB=0.0, zorder=1.0))


def main() -> None:
    """Write the picture and the list in the page."""
    parser = argparse.ArgumentParser(description='Draws docs/architecture.svg from the imports.')
    parser.add_argument('--docs', type=Path, default=_DOCS, help='folder of architecture.md')
    folder = parser.parse_args().docs
    imports = room_imports()
    page = folder / 'architecture.md'
    page.write_text(page_with(page.read_text(), imports))
    draw(folder / 'architecture.svg', imports)


if __name__ == '__main__':
    main()

"""How pictures look: colours that colour-blind readers can tell apart, and matplotlib's style.

The report's page uses the same colours. `@styled` gives them to a function that draws.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, TypeVar

import matplotlib
from matplotlib.rcsetup import cycler

INK, MUTED, GRID, PAPER = '#1c2430', '#5b6675', '#e3e7ec', '#ffffff'
# Blue, vermilion, green, amber, purple, sky, brown and grey: apart for every kind of colour
# blindness, and dark enough on white.
SERIES = ('#0b6bb3', '#c44e12', '#007a5e', '#b58900', '#8f4a9e', '#3f9fd6', '#7a5230', '#5b6675')
ARM_COLOR, PATH_COLOR, OBSTACLE_COLOR = '#1f3a5f', '#007a5e', '#c44e12'
LIMIT_COLOR = '#a3241c'
# Solids that are lit: pale enough to show which way a face looks.
LIT_ARM, LIT_OBSTACLE = '#dee2e8', '#d5703c'
# What boxes with ink on them are filled with.
BLUE_FILL, SAND_FILL, GREY_FILL, AMBER_FILL = '#dbe9f4', '#f3e9dc', '#eef2f6', '#f6c177'
# Commanded and measured are told apart by more than colour.
LINE_STYLES: Mapping[str, str] = MappingProxyType({'commanded': '-', 'measured': '--'})
DPI = 110

STYLE: Mapping[str, Any] = MappingProxyType({
    'font.family': 'sans-serif', 'font.size': 10.0,
    'text.color': INK, 'axes.labelcolor': MUTED, 'axes.titlecolor': INK,
    'axes.titlesize': 10.5, 'axes.titleweight': 'bold', 'axes.titlelocation': 'left',
    'axes.labelsize': 9.0, 'axes.edgecolor': '#b8c0ca', 'axes.linewidth': 0.8,
    'axes.spines.top': False, 'axes.spines.right': False,
    'axes.grid': True, 'axes.axisbelow': True, 'grid.color': GRID, 'grid.linewidth': 0.8,
    'axes.prop_cycle': cycler(color=SERIES), 'lines.linewidth': 1.6,
    'lines.solid_capstyle': 'round', 'axes.formatter.useoffset': False,
    'xtick.color': MUTED, 'ytick.color': MUTED, 'xtick.labelsize': 8.5, 'ytick.labelsize': 8.5,
    'xtick.major.size': 3.0, 'ytick.major.size': 0.0,
    'legend.frameon': False, 'legend.fontsize': 9.0,
    'figure.facecolor': PAPER, 'axes.facecolor': PAPER, 'savefig.dpi': DPI,
    'figure.titlesize': 13.0, 'figure.titleweight': 'bold'})

Drawing = TypeVar('Drawing', bound=Callable[..., Any])


def styled(draw: Drawing) -> Drawing:
    """Return a function whose pictures have this style; matplotlib's settings stay as they are."""
    return matplotlib.rc_context(dict(STYLE))(draw)


def plain_text(text: str) -> str:
    """Return a text so that matplotlib shows it as it is, and sees no formula between dollars."""
    return text.replace('$', r'\$')


def without_panes(axes: Any) -> None:
    """Draw 3-D axes without grey walls, and with a faint grid."""
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.line.set_color('#b8c0ca')
        axis._axinfo['grid'].update(color=GRID, linewidth=0.8)

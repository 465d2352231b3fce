"""Draws what markers become, for docs/obstacles.md: `python -m benchmark.shapes_figure`."""

from __future__ import annotations

import math
from pathlib import Path

from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
import numpy as np
import numpy.typing as npt

from redundant_planner.analysis.figures import set_equal_axes, stretched
from redundant_planner.analysis.style import LIT_OBSTACLE, styled
from redundant_planner.core.obstacles.obstacle import Obstacle

Array = npt.NDArray[np.float64]

_FILE = Path(__file__).resolve().parent.parent / 'docs' / 'figures' / 'shapes.png'
# Points of a surface, around and along it; multiples of 8 meet the edges of a box.
_AROUND, _ALONG = 96, 96
# From above and the right of where one looks from.
_LIGHT = LightSource(azdeg=120.0, altdeg=50.0)


def examples() -> dict[str, list[Obstacle]]:
    """Return what each marker becomes, by its type."""
    steps = [(0.1 * x, 0.1 * y, 0.1 * (x == y)) for x in range(4) for y in range(3)]
    upright = (0.0, 0.0, 0.0, 1.0)
    lying = (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5))
    return {
        'SPHERE': [Obstacle('', (0, 0, 0), (0.2, 0.1, 0.1))],
        'CUBE': [Obstacle.box('', (0, 0, 0), (0.4, 0.2, 0.2))],
        'CYLINDER': [Obstacle.cylinder('', (0, 0, 0), 0.1, 0.4)],
        'LINE_STRIP': [Obstacle.capsule('', center, 0.04, 0.4, orientation=turn) for center, turn
                       in (((0, 0, 0.2), upright), ((0.2, 0, 0.4), lying))],
        'CUBE_LIST': [Obstacle.box('', at, (0.08, 0.08, 0.08)) for at in steps],
        'SPHERE_LIST': [Obstacle('', at, (0.04, 0.04, 0.04)) for at in steps]}


@styled
def draw(path: Path) -> None:
    """Write the picture to a PNG file."""
    figure = Figure(figsize=(10.0, 6.4), layout='constrained')
    turn = np.linspace(0.0, 2.0 * np.pi, _AROUND + 1)
    u, v = np.meshgrid(turn, np.linspace(np.pi, 0.0, _ALONG + 1))
    ball = np.stack((np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)), axis=-1)
    for place, (name, obstacles) in enumerate(examples().items(), 1):
        axes = figure.add_subplot(2, 3, place, projection='3d')
        corners: list[Array] = []
        for one in obstacles:
            surface = stretched(ball, one.shape, one.half_extents) @ one.rotation.T + one.center
            axes.plot_surface(*np.moveaxis(surface, -1, 0), color=LIT_OBSTACLE, linewidth=0,
                              rcount=_ALONG, ccount=_AROUND, antialiased=False,
                              lightsource=_LIGHT)
            corners.append(surface.reshape(-1, 3))
        set_equal_axes(axes, np.vstack(corners))
        axes.set_title(name)
        axes.tick_params(labelsize=7)
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_major_locator(MaxNLocator(4, prune='both'))  # its ends meet in the corners
        axes.set_box_aspect((1, 1, 1), zoom=0.82)  # or the labels are cut off
    figure.savefig(path, dpi=90)


if __name__ == '__main__':
    draw(_FILE)

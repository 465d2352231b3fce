"""Pictures of a motion (matplotlib, files only)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import itertools
import math
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np
import numpy.typing as npt

from redundant_planner.analysis.style import (
    ARM_COLOR,
    LIMIT_COLOR,
    MUTED,
    OBSTACLE_COLOR,
    PATH_COLOR,
    plain_text,
    SERIES,
    styled,
    without_panes,
)
from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, HALF_SPACE, Obstacle
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# A limit is drawn where a curve comes as near as this share of it.
_NEAR = 0.25

@styled
def motion_picture(
    path: Path, robot: Robot, times: Array, positions: Array, velocities: Array,
    obstacles: Sequence[Obstacle], title: str,
) -> None:
    """Write one picture: the arm's motion around the obstacles, and its joint curves.

    Args:
        path: PNG or SVG file to write.
        robot: the arm.
        times: (k,) [s].
        positions, velocities: (k, n).
        obstacles: what it moves among.
        title: above it all.
    """
    figure = Figure(figsize=(13.0, 6.5), layout='constrained')
    figure.suptitle(plain_text(title), x=0.01, ha='left')
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    space = figure.add_subplot(grid[:, 0], projection='3d')
    draw_arm(space, robot, positions[np.linspace(0, len(positions) - 1, 7).astype(int)],
             obstacles)
    tips = np.array([robot.kinematics(q).tip_position for q in positions])
    space.plot(*tips.T, color=PATH_COLOR, linewidth=2.0, label='tip path')
    space.legend(loc='upper left')
    for row, values, label in ((0, positions - positions[0], 'displacement [rad, m]'),
                               (1, velocities, 'velocity [rad/s, m/s]')):
        axes = figure.add_subplot(grid[row, 1])
        for name, series in zip(robot.joint_names, values.T):
            axes.plot(times, series, label=plain_text(name))
        axes.set_ylabel(label)
        if row == 0:
            axes.legend(ncols=4, loc='lower left', bbox_to_anchor=(0.0, 1.0))
        else:
            axes.set_xlabel('time [s]')
    figure.savefig(path)


@styled
def draw_arm(
    axes: Any, robot: Robot, postures: Array, obstacles: Sequence[Obstacle],
) -> None:
    """Draw the links at several postures, the last one darkest, and the obstacles.

    Args:
        axes: 3-D axes.
        robot: the arm.
        postures: (k, n).
        obstacles: what it moves among.
    """
    corners = []
    for i, q in enumerate(postures):
        points = robot.joint_points(q)
        chain = np.vstack((np.zeros(3), points))
        corners.append(chain)
        axes.plot(*chain.T, color=ARM_COLOR, alpha=0.15 + 0.85 * (i + 1) / len(postures),
                  linewidth=2.0 + (i + 1 == len(postures)), marker='o', markersize=3)
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 24), np.linspace(0, np.pi, 12))
    sphere = np.stack((np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)), axis=-1)
    for obstacle in obstacles:
        if obstacle.shape == HALF_SPACE:
            continue
        own = stretched(sphere, obstacle.shape, obstacle.half_extents)
        surface = own @ obstacle.rotation.T + obstacle.center
        axes.plot_surface(*np.moveaxis(surface, -1, 0), color=OBSTACLE_COLOR, alpha=0.6,
                          linewidth=0)
        corners.append(surface.reshape(-1, 3))
    set_equal_axes(axes, np.vstack(corners))
    axes.view_init(elev=18, azim=-35)


def set_equal_axes(axes: Any, extent: Array) -> None:
    """Let 3-D axes show all points (k, 3) at the same scale in every direction."""
    low, high = extent.min(axis=0), extent.max(axis=0)
    half = 0.5 * float((high - low).max())
    for setter, middle in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), 0.5 * (low + high)):
        setter(middle - half, middle + half)
    axes.set_box_aspect((1, 1, 1))
    axes.set_xlabel('x [m]')
    axes.set_ylabel('y [m]')
    axes.set_zlabel('z [m]')
    without_panes(axes)


# Elevation, azimuth and the axis one looks along in the paper's three views of the arm.
_VIEWS = ((18, -35, None), (0, 0, 'x'), (90, -90, 'z'))


@styled
def three_views(
    path: Path, robot: Robot, positions: Array, obstacles: Sequence[Obstacle], title: str,
) -> None:
    """Write the arm's motion from three sides, as in the paper's Figs. 4 and 5.

    Args:
        path: PNG or SVG file to write.
        robot: the arm.
        positions: (k, n).
        obstacles: what it moves among.
        title: above it all.
    """
    figure = Figure(figsize=(15.0, 5.5), layout='constrained')
    figure.suptitle(plain_text(title), x=0.01, ha='left')
    postures = positions[np.linspace(0, len(positions) - 1, 7).astype(int)]
    for i, (elevation, azimuth, along) in enumerate(_VIEWS, start=1):
        axes = figure.add_subplot(1, 3, i, projection='3d')
        draw_arm(axes, robot, postures, obstacles)
        axes.view_init(elev=elevation, azim=azimuth)
        if along:
            axes.set_proj_type('ortho')
            axes.set(**{f'{along}ticks': [], f'{along}label': ''})
    figure.savefig(path)


@styled
def joint_curves(
    path: Path, names: Sequence[str], label: str,
    curves: Mapping[str, tuple[str, Array, Array]], title: str,
    limits: Array | None = None,
) -> None:
    """Write one small diagram per joint with every method in it, as in Figs. 6 to 8.

    Args:
        path: PNG or SVG file to write.
        names: joint names.
        label: of the vertical axis.
        curves: method → (line style, times (k,), values (k, n)).
        title: above it all.
        limits: (n,) largest values that are allowed, infinite for none.
    """
    figure = Figure(figsize=(13.0, 6.5), layout='constrained')
    figure.suptitle(plain_text(title), x=0.01, ha='left')
    columns = (len(names) + 1) // 2
    for i, name in enumerate(names):
        axes = figure.add_subplot(2, columns, i + 1)
        for color, (method, (style, times, values)) in zip(
                itertools.cycle(SERIES), curves.items()):
            axes.plot(times, values[:, i], style, label=plain_text(method), color=color)
        if limits is not None:
            _draw_limit(axes, float(limits[i]))
        axes.set_title(plain_text(name))
        if i >= columns or i + columns >= len(names):
            axes.set_xlabel('time [s]')
        if i % columns == 0:
            axes.set_ylabel(label)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc='outside upper right',
                  ncols=len(curves))
    figure.savefig(path)


def _draw_limit(axes: Any, limit: float) -> None:
    """Draw a limit as lines where they are near the curve, else say where it is."""
    low, high = axes.get_ylim()
    if not math.isfinite(limit):
        return
    if max(-low, high) < _NEAR * limit:
        axes.annotate(f'limit ±{limit:g}', (1.0, 1.0), xycoords='axes fraction', ha='right',
                      va='bottom', fontsize='small', color=MUTED)
        return
    for value in (-limit, limit):
        axes.axhline(value, color=LIMIT_COLOR, linewidth=1.0)


@styled
def robot_picture(
    path: Path, robot: Robot, q: Array, points: Sequence[tuple[str, Array]],
) -> None:
    """Write the arm at one posture: collision geometry, capsules, base and tip frames.

    Args:
        path: PNG or SVG file to write.
        robot: the arm.
        q: (n,) posture.
        points: links and corners (k, 3) of their geometry, in the links' frames.
    """
    figure = Figure(figsize=(13.0, 6.5), layout='constrained')
    figure.suptitle(f"'{robot.name}': collision geometry, capsules, base and tip frames")
    arm = robot.kinematics(q)
    corners = [robot.in_base(q, link, cloud[::max(len(cloud) // 400, 1)])
               for link, cloud in points]
    extent = np.vstack([*corners, arm.segment_start, arm.segment_end, np.zeros((1, 3))])
    for i, (elevation, azimuth) in enumerate(((18, -50), (18, 40)), start=1):
        axes = figure.add_subplot(1, 2, i, projection='3d')
        for cloud in corners:
            axes.scatter(*cloud.T, s=1.5, color=OBSTACLE_COLOR, alpha=0.5)
        for capsule, start, end in zip(robot.capsules, arm.segment_start, arm.segment_end):
            axes.plot_wireframe(*np.moveaxis(capsule_surface(start, end, capsule.radius), -1, 0),
                                color=ARM_COLOR, linewidth=0.4, alpha=0.5)
        for origin, rotation in ((np.zeros(3), np.eye(3)), *arm.tips.each):
            for axis, color in zip(rotation.T, ('red', 'green', 'blue')):
                axes.plot(*np.array((origin, origin + 0.12 * axis)).T, color=color, linewidth=2.0)
        set_equal_axes(axes, extent)
        axes.view_init(elev=elevation, azim=azimuth)
    figure.savefig(path)


def stretched(ball: Array, shape: str, half_extents: Array) -> Array:
    """Return the points of an obstacle's surface in its own axes [m].

    Args:
        ball: (..., 3) points of the unit ball's surface, each of which becomes one.
        shape, half_extents: of the obstacle.
    """
    # A ball through the corners is pressed flat: many of its points then lie on the edges.
    if shape == BOX:
        return np.clip(math.sqrt(3.0) * ball, -1.0, 1.0) * half_extents
    if shape == CYLINDER:
        around = math.sqrt(2.0) * np.linalg.norm(ball[..., :2], axis=-1, keepdims=True)
        wide = math.sqrt(2.0) * ball[..., :2] / np.maximum(around, 1.0)
        high = np.clip(math.sqrt(2.0) * ball[..., 2:], -1.0, 1.0)
        return np.concatenate((wide, high), axis=-1) * half_extents
    if shape == CAPSULE:
        radius = half_extents[0]
        apart = np.array((0.0, 0.0, half_extents[2] - radius))
        return ball * radius + np.sign(ball[..., 2:]) * apart
    return ball * half_extents


def capsule_surface(
    start: Array, end: Array, radius: float, ribs: int = 10, sides: int = 17,
) -> Array:
    """Return a grid of points (ribs, sides, 3) on a capsule's surface [m]; `ribs` is even."""
    along = end - start
    length = float(np.linalg.norm(along))
    z = along / length if length > 0.0 else np.array((0.0, 0.0, 1.0))
    x = np.cross(z, (1.0, 0.0, 0.0) if abs(z[0]) < 0.9 else (0.0, 1.0, 0.0))
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    half = ribs // 2
    tilt = np.concatenate((np.linspace(-np.pi / 2, 0.0, half), np.linspace(0.0, np.pi / 2, half)))
    height = radius * np.sin(tilt) + np.where(np.arange(ribs) < half, 0.0, length)
    turn = np.linspace(0.0, 2.0 * np.pi, sides)
    ring = np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * y
    return start + height[:, None, None] * z + radius * np.cos(tilt)[:, None, None] * ring

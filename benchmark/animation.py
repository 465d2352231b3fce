"""Draws the README's moving picture: `python -m benchmark.animation`.

A Panda moves its hand along the same line twice, past the same obstacles: by plain inverse
kinematics on the left, by this package's planner on the right. A link is red while it is inside
an obstacle. The Panda comes with `pip install example-robot-data`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
import numpy as np
import numpy.typing as npt
from PIL import Image

from benchmark.generator import DURATION, Task
from benchmark.robots import make_robot
from benchmark.scenarios import DT
from redundant_planner.analysis.figures import capsule_surface, stretched
from redundant_planner.analysis.style import (
    GRID,
    INK,
    LIMIT_COLOR,
    LIT_ARM,
    LIT_OBSTACLE,
    PAPER,
    PATH_COLOR,
    styled,
)
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.robot.model import Robot
from redundant_planner.simulation import simulate

Array = npt.NDArray[np.float64]

_BASE = '#adb5bd'
# Where one looks from and where the light comes from, in the base frame.
_ELEVATION, _AZIMUTH = np.deg2rad(24.0), np.deg2rad(-8.0)
_LIGHT = np.array((0.6, -0.3, 0.75)) / np.linalg.norm((0.6, -0.3, 0.75))
# What the picture shows, to the right and upwards [m].
_WINDOW = ((-0.62, 0.62), (-0.25, 0.87))
# How long the last posture stays [s].
_PAUSE = 0.9


class Surface(NamedTuple):
    """Part of a picture.

    Attributes:
        faces: (f, 4, 3) quadrilaterals, in the base frame [m].
        color: of all of them.
    """

    faces: Array
    color: str


def task() -> Task:
    """Return the motion: the hand moves sideways by 0.55 m, and balls stand in the elbow's way."""
    start = np.array((0.45, -0.45, 0.15, -2.2, 0.1, 1.75, 1.1))
    along = 2.0 * 0.55 / DURATION
    return Task(0, start, np.array((0.0, -along, 0.0, 0.0, 0.0, 0.0)), (
        Obstacle('behind', np.array((-0.14, -0.23, 0.64)), np.full(3, 0.09)),
        Obstacle('above', np.array((0.03, -0.27, 0.81)), np.full(3, 0.08)),
        Obstacle('below', np.array((0.08, -0.22, 0.22)), np.full(3, 0.09))))


def plain_inverse_kinematics(robot: Robot, motion: Task) -> Array:
    """Return the postures (k + 1, n) of J⁺ẋ within position and velocity limits."""
    postures = [motion.start]
    for i in range(round(DURATION / DT)):
        q = postures[-1]
        parts = null_space.decompose(robot.kinematics(q).jacobian)
        dq = null_space.least_norm(
            parts, 1.0 / parts.singular_values, robot.task_rows(motion.twist_at(i * DT)))
        dq = dq / max(1.0, float((np.abs(dq) / robot.velocity_max).max()))
        postures.append(np.clip(q + DT * dq, robot.position_min, robot.position_max))
    return np.array(postures)


def planned(robot: Robot, motion: Task) -> Array:
    """Return the postures (k + 1, n) of the planner with its default parameters."""
    return simulate(Planner(robot, PlannerParameters()), motion.start, motion.twist_at,
                    Scene.of(motion.obstacles), DURATION, DT).positions


def depths(robot: Robot, obstacles: Sequence[Obstacle], q: Array) -> Array:
    """Return the smallest clearance ρ (c,) of each link to any obstacle, negative inside."""
    arm = robot.kinematics(q)
    radii = np.array([capsule.radius for capsule in robot.capsules])
    maps = inflated_obstacles(Scene.of(obstacles), radii, moved=robot.moved)
    pairs = link_clearance(maps, arm.segment_start, arm.segment_end)
    return pairs.normalized_distance.min(axis=1)


def arm_surfaces(robot: Robot, obstacles: Sequence[Obstacle], q: Array) -> list[Surface]:
    """Return the links' capsules at a posture, red where they are inside an obstacle."""
    arm = robot.kinematics(q)
    inside = depths(robot, obstacles, q) < 0.0
    return [
        Surface(_quads(capsule_surface(start, end, capsule.radius, 14, 25)),
                LIMIT_COLOR if hit else LIT_ARM)
        for capsule, start, end, hit in zip(
            robot.capsules, arm.segment_start, arm.segment_end, inside)]


def standing_surfaces(obstacles: Sequence[Obstacle]) -> list[Surface]:
    """Return the obstacles and the arm's base, which do not move."""
    turn, tilt = np.meshgrid(
        np.linspace(0.0, 2.0 * np.pi, 33), np.linspace(-np.pi / 2, np.pi / 2, 17))
    ball = np.stack((np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)), -1)
    found = [
        Surface(_quads(stretched(ball, o.shape, o.half_extents) @ o.rotation.T + o.center),
                LIT_OBSTACLE) for o in obstacles]
    base = capsule_surface(np.array((0.0, 0.0, 0.03)), np.array((0.0, 0.0, 0.12)), 0.085, 14, 25)
    return [*found, Surface(_quads(base), _BASE)]


def _quads(grid: Array) -> Array:
    """Return the quadrilaterals (f, 4, 3) of a grid (rows, columns, 3), normals outwards."""
    corners = np.stack((grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]), axis=2)
    return corners.reshape(-1, 4, 3)


def _camera() -> tuple[Array, Array]:
    """Return the picture's axes (2, 3), to the right and upwards, and where one looks from."""
    toward = np.array((np.cos(_ELEVATION) * np.cos(_AZIMUTH),
                       np.cos(_ELEVATION) * np.sin(_AZIMUTH), np.sin(_ELEVATION)))
    right = np.array((-np.sin(_AZIMUTH), np.cos(_AZIMUTH), 0.0))
    return np.vstack((right, np.cross(toward, right))), toward


def draw(axes: Any, surfaces: Sequence[Surface]) -> None:
    """Draw surfaces from the farthest face to the nearest, lit from above."""
    picture, toward = _camera()
    faces = np.concatenate([surface.faces for surface in surfaces])
    colors = np.concatenate([
        np.tile(matplotlib.colors.to_rgb(s.color), (len(s.faces), 1)) for s in surfaces])
    normals = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    sizes = np.linalg.norm(normals, axis=1)
    seen = (sizes > 1e-12) & (normals @ toward > 0.0)
    faces, colors = faces[seen], colors[seen]
    bright = 0.55 + 0.45 * np.clip(normals[seen] @ _LIGHT / sizes[seen], 0.0, 1.0)
    order = np.argsort(faces.mean(axis=1) @ toward)
    shades = np.round(np.clip(bright, 0.0, 1.0) * 24) / 24  # few colours make a small file
    shown = np.clip(colors * shades[:, None], 0.0, 1.0)[order]
    axes.add_collection(PolyCollection(
        list((faces @ picture.T)[order]), facecolors=shown, edgecolors=shown, linewidths=0.4,
        zorder=2.0))


def _floor(axes: Any) -> None:
    picture, _ = _camera()
    ticks = np.linspace(-0.4, 0.8, 7)
    lines = [np.array(((x, -0.6, 0.0), (x, 0.6, 0.0))) @ picture.T for x in ticks]
    lines += [np.array(((-0.4, y, 0.0), (0.8, y, 0.0))) @ picture.T for y in ticks - 0.2]
    axes.add_collection(LineCollection(lines, colors=GRID, linewidths=0.8, zorder=1.0))


@styled
def frame(
    robot: Robot, obstacles: Sequence[Obstacle], sides: Sequence[tuple[str, Array]], index: int,
    width: int,
) -> Image.Image:
    """Draw one frame.

    Args:
        robot: the arm.
        obstacles: the ellipsoids.
        sides: title and postures (k, n) of the left and the right half.
        index: of the posture.
        width: of the picture [pixels].
    """
    dpi = 100.0
    figure = Figure(figsize=(width / dpi, 0.52 * width / dpi), dpi=dpi, facecolor=PAPER)
    canvas = FigureCanvasAgg(figure)
    standing, (picture, _) = standing_surfaces(obstacles), _camera()
    size = width / 80.0
    for side, (title, postures) in enumerate(sides):
        axes = figure.add_axes((0.5 * side, 0.0, 0.5, 0.88))
        axes.set(xlim=_WINDOW[0], ylim=_WINDOW[1], aspect='equal')
        axes.set_axis_off()
        _floor(axes)
        draw(axes, standing + arm_surfaces(robot, obstacles, postures[index]))
        tips = np.array([robot.kinematics(q).tip_position for q in postures[::20]]) @ picture.T
        axes.plot(*tips.T, color=PATH_COLOR, linewidth=0.15 * size, linestyle=(0, (3, 2)),
                  zorder=3.0)
        axes.plot(*(robot.kinematics(postures[index]).tip_position @ picture.T), 'o',
                  color=PATH_COLOR, markersize=0.5 * size, zorder=3.0)
        hit = min(depths(robot, obstacles, q).min() for q in postures[:index + 1:5]) < 0.0
        figure.text(0.5 * side + 0.25, 0.945, title, ha='center', va='center', color=INK,
                    fontsize=size * 1.15, fontweight='bold')
        figure.text(0.5 * side + 0.25, 0.885, 'has run into an obstacle' if hit else 'no contact',
                    ha='center', va='center', fontsize=size,
                    color=LIMIT_COLOR if hit else INK)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def write_animation(path: Path, *, frames: int, width: int) -> None:
    """Simulate both motions and write them as one GIF or WebP file.

    Args:
        path: its suffix says which.
        frames: how many.
        width: [pixels].
    """
    robot, motion = make_robot('panda', 6), task()
    sides = (('plain inverse kinematics', plain_inverse_kinematics(robot, motion)),
             ('redundant_planner', planned(robot, motion)))
    pictures = [frame(robot, motion.obstacles, sides, index, width)
                for index in np.linspace(0, len(sides[0][1]) - 1, frames).astype(int)]
    each = round(1e3 * DURATION / frames)
    durations = [each] * (frames - 1) + [each + round(1e3 * _PAUSE)]
    if path.suffix == '.gif':
        # One palette for all frames: what does not change is then stored once.
        palette = pictures[len(pictures) // 2].quantize(160, Image.Quantize.MAXCOVERAGE)
        pictures = [p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=durations, loop=0,
                     optimize=True)


def main() -> None:
    """Write the moving picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=Path, default=Path('docs/passing_obstacles.gif'),
                        help='GIF or WebP file to write')
    parser.add_argument('--frames', type=int, default=80)
    parser.add_argument('--width', type=int, default=800, help='pixels')
    options = parser.parse_args()
    write_animation(options.out, frames=options.frames, width=options.width)
    print(f'{options.out}: {options.out.stat().st_size / 1e6:.1f} MB')


if __name__ == '__main__':
    main()

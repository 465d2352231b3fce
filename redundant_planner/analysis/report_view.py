"""The arm and its obstacles over time, as grids of points for the report's 3-D view."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis.figures import capsule_surface, stretched
from redundant_planner.analysis.motion_interval import command_begin, motion_interval
from redundant_planner.analysis.results import Analysis, scene_at
from redundant_planner.core.obstacles.obstacle import SHAPES
from redundant_planner.core.obstacles.scene import Scene

Array = npt.NDArray[np.float64]

# Postures of the 3-D view: what a screen can show of the motion, and before and after it.
_POSTURES, _AROUND_MOTION = 220, 20
_RIBS, _SIDES = 6, 11  # grid of a link
_BALL_RIBS, _BALL_SIDES = 10, 19  # of an obstacle
# Obstacles drawn in all postures together: the nearest ones.
_GRIDS = 6000
# How far around the arm obstacles are drawn, and how large one may be, in sizes of its motion.
_AROUND, _LARGE = 1.5, 1000.0
# The view is at least as deep as this share of its largest side.
_FLAT = 0.35


def view_of(analysis: Analysis, shown: tuple[float, float]) -> dict[str, Any]:
    """Return the arm at some postures as grids of points, and its obstacles.

    Times count from the begin of the command; the view begins with the posture `first`.

    Args:
        analysis: of a bag with a robot.
        shown: from when to when, likewise [s].
    """
    robot, curves = analysis.robot, analysis.curves
    assert robot is not None
    origin = command_begin(curves)
    chosen, first = _postures(curves.times - origin, *shown)
    arms = robot.kinematics_along(curves.positions[chosen])
    radii = [max(capsule.radius, 0.005) for capsule in robot.capsules]
    surfaces = np.array([
        [capsule_surface(start, end, radius, _RIBS, _SIDES).reshape(-1, 3)
         for start, end, radius in zip(starts, ends, radii)]
        for starts, ends in zip(arms.segment_start, arms.segment_end)])
    chains = np.array([np.vstack((np.zeros(3), robot.joint_points(q)))
                       for q in curves.positions[chosen]])
    # What comes into view with the command is there from the first posture on.
    begin = motion_interval(curves)[0]
    scenes = [scene_at(curves, max(float(time), begin if i >= first else -np.inf))
              for i, time in enumerate(curves.times[chosen])]
    corners = chains.reshape(-1, 3)
    most = _GRIDS // len({id(scene) for scene in scenes})
    near = {id(scene): nearest_obstacles(scene, corners, most) for scene in scenes}
    width = max(len(rows) for rows in near.values())
    low, high = corners.min(axis=0), corners.max(axis=0)
    edges = _AROUND * (high - low).max()
    drawn: dict[str, int] = {}
    which: list[int] = []
    extents = [corners]
    for scene in scenes:
        rows = near[id(scene)]
        # As many in every scene: those that are missing are points at the origin.
        grids = np.zeros((width, _BALL_RIBS * _BALL_SIDES, 3))
        grids[:len(rows)] = _surfaces(scene, rows)
        packed = packed_numbers(grids)
        if packed not in drawn:
            drawn[packed] = len(drawn)
            extents.append(np.clip(grids[:len(rows)].reshape(-1, 3), low - edges, high + edges))
        which.append(drawn[packed])
    extent = np.vstack((*extents, surfaces.reshape(-1, 3)))
    middle = 0.5 * (extent.min(axis=0) + extent.max(axis=0))
    half = 0.5 * (extent.max(axis=0) - extent.min(axis=0)) + 0.02
    half = np.maximum(half, _FLAT * half.max())
    return {
        'times': np.round(curves.times[chosen] - origin, 4).tolist(),
        'first': first,
        'vertices': packed_numbers(surfaces), 'capsules': len(radii), 'grid': [_RIBS, _SIDES],
        'ball': [_BALL_RIBS, _BALL_SIDES],
        'chain': packed_numbers(chains),
        'tips': packed_numbers(arms.tip_positions[::len(robot.tips)]),
        'obstacles': list(drawn),
        'hidden': max(len(scene.names) - len(near[id(scene)]) for scene in scenes),
        'scene': which, 'range': np.column_stack((middle - half, middle + half)).tolist()}


def _postures(times: Array, begin: float, end: float) -> tuple[npt.NDArray[np.intp], int]:
    """Return which samples are shown, (k,), and which of them is the first from `begin` on."""
    inside = np.flatnonzero((times >= begin) & (times <= end))
    chosen = np.union1d(inside[np.linspace(0, len(inside) - 1, _POSTURES).astype(int)],
                        np.linspace(0, len(times) - 1, _AROUND_MOTION).astype(int))
    return chosen.astype(np.intp), int(np.searchsorted(chosen, inside[0]))


def packed_numbers(values: npt.ArrayLike) -> str:
    """Return numbers as the page's script reads them."""
    return base64.b64encode(np.asarray(values, dtype='<f4').tobytes()).decode()


def nearest_obstacles(scene: Scene, corners: Array, most: int) -> npt.NDArray[np.intp]:
    """Return which obstacles are drawn around an arm's points (k, 3): the nearest ones."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent = float((high - low).max()) + 1e-3
    sizes = scene.half_extents.max(axis=1, initial=0.0)
    with np.errstate(over='ignore'):
        outside = np.maximum(np.maximum(low - scene.centers, scene.centers - high), 0.0)
        away = np.linalg.norm(outside, axis=1) - sizes
    candidates = np.flatnonzero((away < _AROUND * extent) & (sizes < _LARGE * extent))
    return np.sort(candidates[np.argsort(away[candidates], kind='stable')[:most]])


def _surfaces(scene: Scene, rows: npt.NDArray[np.intp]) -> Array:
    """Return grids of points like that of `capsule_surface` on obstacles, (k, u v, 3)."""
    ball = capsule_surface(
        np.zeros(3), np.zeros(3), 1.0, _BALL_RIBS, _BALL_SIDES).reshape(-1, 3)
    scaled = np.empty((len(rows), len(ball), 3))
    for place, row in enumerate(rows.tolist()):
        scaled[place] = stretched(ball, SHAPES[scene.shapes[row]], scene.half_extents[row])
    return scaled @ scene.rotations[rows].transpose(0, 2, 1) + scene.centers[rows, None]

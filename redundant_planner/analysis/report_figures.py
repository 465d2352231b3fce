"""The figures beside a report, for a paper or a presentation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis.figures import joint_curves, motion_picture
from redundant_planner.analysis.motion_interval import command_begin, shown_interval
from redundant_planner.analysis.report_view import nearest_obstacles
from redundant_planner.analysis.results import Analysis, Curves, scene_at
from redundant_planner.analysis.style import LINE_STYLES

Array = npt.NDArray[np.float64]

# Samples of a curve: what a screen can show.
_CURVE = 1500
# Obstacles drawn in a picture: the nearest ones.
_PICTURED = 200
# Joints in a figure.
_DIAGRAMS = 32


def write_figures(
    folder: Path, analysis: Analysis, suffixes: tuple[str, ...] = ('png', 'svg'),
) -> None:
    """Write the figures of an analysis to a folder."""
    curves, robot = analysis.curves, analysis.robot
    chosen = _motion_samples(curves)
    times = curves.times[chosen] - command_begin(curves)
    names, title = analysis.joint_names[:_DIAGRAMS], f"'{analysis.name}'"
    if len(names) < len(analysis.joint_names):
        title += f': the first {len(names)} of {len(analysis.joint_names)} joints'
    for suffix in suffixes:
        for kind, label, found, limits in (
                ('displacement', 'displacement [rad, m]',
                 {'measured': curves.positions - curves.positions[0]}, None),
                ('velocity', 'velocity [rad/s, m/s]', velocities_of(curves),
                 robot.velocity_max if robot is not None else None),
                ('acceleration', 'acceleration [rad/s², m/s²]', accelerations_of(curves),
                 robot.acceleration_max if robot is not None else None)):
            joint_curves(folder / f'{analysis.name}_{kind}.{suffix}', names, label,
                         {name: (LINE_STYLES[name], times, values[chosen])
                          for name, values in found.items()}, title, limits)
        if robot is not None:
            scene = scene_at(curves, float(curves.times[-1]))
            corners = np.vstack([robot.joint_points(q) for q in curves.positions[chosen]])
            obstacles = scene.obstacles()
            motion_picture(
                folder / f'{analysis.name}_motion.{suffix}', robot, times,
                curves.positions[chosen], curves.velocities[chosen],
                [obstacles[i] for i in nearest_obstacles(scene, corners, _PICTURED)],
                f"'{analysis.name}'")


def velocities_of(curves: Curves) -> dict[str, Array]:
    """Return 'measured' and, where there are commands, 'commanded' → velocities (k, n)."""
    found = {'measured': curves.velocities}
    if curves.commanded is not None:
        found['commanded'] = curves.commanded[0]
    return found


def accelerations_of(curves: Curves) -> dict[str, Array]:
    """Return 'commanded' or, without commands, 'measured' → accelerations (k, n).

    Differences of measured velocities tell of jitter and noise more than of the motion.
    """
    if curves.commanded is not None:
        return {'commanded': curves.commanded[1]}
    return {'measured': curves.accelerations}


def _motion_samples(curves: Curves) -> npt.NDArray[np.intp]:
    """Return which samples of the motion are drawn, (k,)."""
    begin, end = shown_interval(curves)
    moving = np.flatnonzero((curves.times >= begin) & (curves.times <= end))
    return moving[np.unique(np.linspace(0, len(moving) - 1, _CURVE).astype(int))]

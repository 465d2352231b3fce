"""show_robot: a picture of an arm as the planner sees it, and a parameter file to start from."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
import sys
import time
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table
import yaml

from redundant_planner.analysis.figures import robot_picture
from redundant_planner.core.errors import PlannerError, RobotError
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.collision_geometry import collision_pieces
from redundant_planner.io.link_shapes import capsule_entry, Fit, fitted_capsules
from redundant_planner.io.parameter_files import (
    read_robot_parameters,
    RobotParameters,
    urdf_folder,
    urdf_text,
)
from redundant_planner.io.resources import read_text, resolve
from redundant_planner.io.robot_files import build_robot, likely_tip

Array = npt.NDArray[np.float64]


def parameter_file(parameters: RobotParameters, robot: Robot) -> str:
    """Return a ROS parameter file for a robot, its capsules included."""
    capsules = {c.name: capsule_entry(c) for c in robot.capsules}
    given = {entry.name: getattr(parameters, entry.name) for entry in fields(parameters)
             if getattr(parameters, entry.name) != entry.default}
    values: dict[str, Any] = {
        'urdf': parameters.urdf, 'base_frame': robot.base_frame, 'tip_frame': robot.tip_frame,
        'axes': robot.axes, 'acceleration_max': robot.acceleration_max.tolist(), **given,
        'capsules': list(capsules), 'capsule': capsules}
    values = {key: list(value) if isinstance(value, tuple) else value
              for key, value in values.items()}
    text = yaml.dump({'/**': {'ros__parameters': values}}, sort_keys=False, width=99,
                     default_flow_style=None)
    return ('# Made by show_robot. A URDF has no acceleration limits: replace acceleration_max by '
            "your\n# drives' own. The capsules contain all of the collision geometry that the "
            f'chain moves.\n{text}')


def main(args: list[str] | None = None) -> int:
    """Run show_robot; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='show_robot', description=__doc__)
    parser.add_argument('--urdf', help='path, file:// or package:// location of the URDF')
    parser.add_argument('--params', type=Path, help='parameter file of the robot instead')
    parser.add_argument('--tip', help='link that is the end effector; the end of the longest '
                                      'chain, before its hand, if not given')
    parser.add_argument('--base', default='', help='base link; the root if not given')
    parser.add_argument('--posture', type=float, nargs='+', metavar='Q',
                        help='joint positions to draw; the middle of the range if not given')
    parser.add_argument('--out', type=Path, default=Path('robot.png'),
                        help='picture to write, PNG or SVG (default: %(default)s)')
    options = parser.parse_args(args)
    console = Console(stderr=True)
    try:
        parameters, capsules, folder = _parameters(options)
        began = time.monotonic()
        robot = build_robot(
            parameters, urdf_text(parameters, folder), capsules, folder=folder,
            warn=lambda sentence: console.print(f'careful: {sentence}', style='yellow'))
        fits: Sequence[Fit] = ()
        points: list[tuple[str, Array]] = []
        if parameters.link_shapes == 'fitted' and not parameters.capsules:
            fits = fitted_capsules(robot, urdf_folder(parameters, folder))
        if parameters.urdf:
            try:
                points = [(piece.link, piece.points) for piece in collision_pieces(
                    robot, urdf_folder(parameters, folder))]
            except RobotError as error:
                console.print(f'no meshes in the picture: {error}', style='yellow')
        posture = _posture(robot, options.posture)
        try:
            robot_picture(options.out, robot, posture, points)
        except (OSError, ValueError) as error:
            raise PlannerError(f"the picture '{options.out}' cannot be made: {error}") from None
        console.print(_table(robot, fits, time.monotonic() - began))
        console.print(f'picture: {options.out}')
        print(parameter_file(parameters, robot), end='')
    except PlannerError as error:
        print(f'show_robot: {error}', file=sys.stderr)
        return 2
    return 0


def _parameters(
    options: argparse.Namespace,
) -> tuple[RobotParameters, dict[str, Mapping[str, Any]], Path | None]:
    if options.params is not None:
        parameters, capsules = read_robot_parameters(options.params)
        changes = {key: value for key, value in (
            ('urdf', options.urdf), ('tip_frame', options.tip), ('base_frame', options.base))
            if value}
        return replace(parameters, **changes), capsules, options.params.parent
    if not options.urdf:
        raise PlannerError('give --urdf or --params')
    text = read_text(resolve(options.urdf))
    tip = options.tip or likely_tip(text)
    parameters = RobotParameters(urdf=options.urdf, tip_frame=tip, base_frame=options.base)
    slow = _without_speed(text, parameters)
    return (replace(parameters, velocity_max=(1.0,)) if slow else parameters), {}, None


def _without_speed(urdf: str, parameters: RobotParameters) -> bool:
    """Return whether some chain joint has no velocity limit in the URDF."""
    try:
        Robot(urdf, parameters.tip_frame, base_frame=parameters.base_frame, capsules=[])
    except RobotError as error:
        if 'velocity_max' in str(error):
            print(f'show_robot: {error}; 1.0 is taken', file=sys.stderr)
            return True
        raise
    return False


def _posture(robot: Robot, given: Sequence[float] | None) -> Array:
    if given is not None:
        return robot.checked_posture(given)
    low = np.where(np.isfinite(robot.position_min), robot.position_min, 0.0)
    high = np.where(np.isfinite(robot.position_max), robot.position_max, 0.0)
    return np.clip(0.5 * (low + high), robot.position_min, robot.position_max)


def _table(robot: Robot, fits: Sequence[Fit], seconds: float) -> Table:
    table = Table(title=f"'{robot.name}' from {robot.base_frame} to {robot.tip_frame}: "
                        f'{robot.n} joints, {len(robot.capsules)} capsules, {seconds:.1f} s')
    for heading in ('joint', 'links', 'corners', 'capsules', 'volume ratio'):
        table.add_column(heading)
    for fit in fits:
        table.add_row(fit.joint, ', '.join(fit.links[:3]) + (' …' if len(fit.links) > 3 else ''),
                      str(fit.corners), str(len(fit.capsules)), f'{fit.ratio:.2f}')
    return table


if __name__ == '__main__':
    raise SystemExit(main())

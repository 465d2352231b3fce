"""show_robot: a picture of an arm as the planner sees it, and a parameter file to start from.

The file has a posture at which a simulated arm starts: clear of itself, away from limits and
singularities.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
import shlex
import sys
import time
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table
import yaml

from redundant_planner.analysis.figures import robot_picture
from redundant_planner.core.errors import known, PlannerError, RobotError
from redundant_planner.core.parameters import AXES
from redundant_planner.core.robot.joint_limits import DEFAULT, Sources, URDF
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.possible_axes import possible_axes
from redundant_planner.core.robot.urdf import read_urdf
from redundant_planner.core.target.start_posture import start_posture
from redundant_planner.io.collision_geometry import collision_pieces
from redundant_planner.io.likely_tips import likely_tip, likely_tips
from redundant_planner.io.limit_report import limit_lines, narrower_soft_limits
from redundant_planner.io.link_shapes import capsule_entry, Fit, fitted_capsules
from redundant_planner.io.node_parameters import FakeHardwareParameters
from redundant_planner.io.parameter_files import (
    read_parameter_file,
    read_robot_parameters,
    RobotParameters,
    settings_of,
    urdf_folder,
    urdf_text,
)
from redundant_planner.io.resources import resolve
from redundant_planner.io.robot_files import build_robot
from redundant_planner.io.xacro_files import expanded, urdf_in

Array = npt.NDArray[np.float64]


_PACKAGE = 'package://'
# Taken where a URDF has no velocity limit [rad/s, m/s].
_VELOCITY = 1.0


@dataclass(frozen=True)
class Described:
    """What tells an arm from another: its parameters, and the shapes that they name.

    Attributes:
        parameters: of the robot; `urdf` is a package:// location or an absolute path.
        capsules: name → {frame, start, end, radius}.
        start: joint name → where a simulated arm starts [rad, m]; empty for a proposal.
        assumed: joints whose velocity limit in the parameters is a guess, as the URDF has none;
            the others have the URDF's there.
    """

    parameters: RobotParameters
    capsules: Mapping[str, Mapping[str, Any]]
    start: Mapping[str, float]
    assumed: tuple[str, ...] = ()


def described_by_urdf(
    urdf: str, tip: str, base: str, warn: Callable[[str], object], tips: Sequence[str] = (),
) -> Described:
    """Return what a URDF says of an arm.

    Args:
        urdf: path, file:// or package:// location.
        tip: link that is the end effector; the likely one if empty.
        base: base link; the root if empty.
        warn: takes a sentence about what the URDF lacks.
        tips: such links of a body with several arms, instead of `tip`.

    Raises:
        PlannerError: it cannot be read, or describes no such arm.
    """
    text = urdf_in(resolve(urdf))
    parameters = RobotParameters(
        urdf=_from_anywhere(urdf, None), base_frame=base, tips=tuple(tips),
        tip_frame=tip or ('' if tips else likely_tip(text)))
    chain = Robot(text, parameters.tip_frame, tips=tips, base_frame=base, velocity_max=_VELOCITY,
                  capsules=[])
    known_ones = {joint.name: joint.velocity for joint in read_urdf(text).joints}
    velocities = {name: known_ones[name] for name in chain.joint_names}
    assumed = tuple(name for name, limit in velocities.items() if not limit)
    if assumed:
        warn(f'the URDF has no velocity limit for {known(assumed)}; {_VELOCITY} is taken')
        parameters = replace(parameters, velocity_max=tuple(
            limit or _VELOCITY for limit in velocities.values()))
    if sentence := narrower_soft_limits(chain):
        warn(sentence)
    axes = AXES if tips else possible_axes(chain)
    if axes != AXES:
        missing = [axis for axis in AXES if axis not in axes]
        warn(f"an arm with these {chain.n} joints cannot follow every twist: 'axes' is "
             f"{', '.join(axes)}, and its motion along {', '.join(missing)} is left to the null "
             "space; name other axes in the file if it should follow those")
        parameters = replace(parameters, axes=axes)
    return Described(parameters, {}, {}, assumed)


def described_by_file(
    path: Path, urdf: str = '', tip: str = '', base: str = '', tips: Sequence[str] = (),
) -> Described:
    """Return what a parameter file says of an arm.

    Args:
        path: of the file.
        urdf, tip, base, tips: what replaces the file's; empty for nothing.

    Raises:
        PlannerError: it cannot be used.
    """
    parameters, capsules = read_robot_parameters(path)
    simulated = settings_of(FakeHardwareParameters, read_parameter_file(path))
    parameters = replace(
        parameters, tip_frame='' if tips else tip or parameters.tip_frame,
        tips=tuple(tips) or (() if tip else parameters.tips),
        base_frame=base or parameters.base_frame,
        urdf=_from_anywhere(urdf, None) if urdf else _from_anywhere(parameters.urdf, path.parent))
    return Described(parameters, capsules, dict(
        zip(simulated.initial_joints, simulated.initial_positions)))


def _from_anywhere(urdf: str, folder: Path | None) -> str:
    """Return a location that means the same file from any folder."""
    return urdf if urdf.startswith(_PACKAGE) or not urdf else str(resolve(urdf, folder))


@dataclass(frozen=True)
class Arm:
    """An arm as the planner sees it.

    Attributes:
        parameters: that describe it.
        robot: the arm.
        start: joint name → where a simulated arm starts [rad, m].
        posture: (n,) of the chain then [rad, m].
        sources: where its limits are from.
    """

    parameters: RobotParameters
    robot: Robot
    start: Mapping[str, float]
    posture: Array
    sources: Sources


def arm_of(
    described: Described, warn: Callable[[str], object], posture: Sequence[float] | None = None,
) -> Arm:
    """Build an arm, its capsules fitted, and find where it should start.

    Args:
        described: the arm.
        warn: takes a sentence about links that nothing protects.
        posture: (n,) to start at; the given one, or else a proposal, if None.

    Raises:
        PlannerError: it cannot be built, or does not have such a posture.
    """
    parameters = described.parameters
    robot = build_robot(parameters, urdf_text(parameters), described.capsules, warn=warn)
    names, sources = robot.joint_names, robot.limit_sources
    if described.assumed:
        sources = sources._replace(velocity=tuple(
            DEFAULT if name in described.assumed else URDF for name in names))
    if posture is not None:
        q = robot.checked_posture(posture)
    elif described.start:
        # What is not named starts at 0, or at the limit nearest to it.
        q = np.clip([described.start.get(name, 0.0) for name in names],
                    robot.position_min, robot.position_max)
        return Arm(parameters, robot, described.start, q, sources)
    else:
        q = start_posture(robot)
    start = {**parameters.locked, **dict(zip(names, q.tolist()))}
    return Arm(parameters, robot, start, q, sources)


def parameter_file(
    parameters: RobotParameters, robot: Robot, start: Mapping[str, float] | None = None,
    sources: Sources | None = None,
) -> str:
    """Return a ROS parameter file for a robot, its capsules included.

    Acceleration limits that the URDF has for all joints are left to it, so that a corrected URDF
    counts.

    Args:
        parameters: that it was built with.
        robot: the arm.
        start: joint name → where a simulated arm starts [rad, m].
        sources: where its limits are from, for a comment; None for what the robot says.
    """
    sources = sources or robot.limit_sources
    capsules = {c.name: capsule_entry(c) for c in robot.capsules}
    given = {entry.name: getattr(parameters, entry.name) for entry in fields(parameters)
             if getattr(parameters, entry.name) != entry.default}
    starts = {} if not start else {
        'initial_joints': list(start), 'initial_positions': list(map(float, start.values()))}
    accelerations = {} if set(sources.acceleration) == {URDF} else {
        'acceleration_max': robot.acceleration_max.tolist()}
    tip = {} if parameters.tips else {'tip_frame': robot.tip_frame}
    values: dict[str, Any] = {
        'urdf': parameters.urdf, 'base_frame': robot.base_frame, **tip, 'axes': robot.axes,
        **accelerations, **given,
        **starts, 'capsules': list(capsules), 'capsule': capsules}
    values = {key: list(value) if isinstance(value, tuple) else value
              for key, value in values.items()}
    text = yaml.dump({'/**': {'ros__parameters': values}}, sort_keys=False, width=99,
                     default_flow_style=None)
    ask = '' if DEFAULT not in sources.acceleration else (
        "# The URDF has no acceleration limits for all joints: replace acceleration_max by your\n"
        "# drives' own.\n")
    return ('# Made by show_robot. The capsules contain all of the collision geometry that the '
            'chain moves,\n# fingers at any opening unless locked_joints locks them, and what is '
            'fixed to the base, large\n# links excepted (docs/robots.md, Link shapes).\n' + ask
            + ('' if not start else
            '# A simulated arm (fake_hardware_node, mujoco_hardware_node) starts at '
            'initial_positions.\n') + '# The limits, and where each was from when this was '
            'written; what is a parameter below replaces it:\n'
            + ''.join(f'# {line}\n' for line in limit_lines(robot, sources)) + text)


def said_of_limits(arm: Arm) -> str:
    """Return the limits of an arm's joints, each with where it is from, as text of a few lines."""
    return '\n'.join(['limits, and where each is from:', *(
        f'  {line}' for line in limit_lines(arm.robot, arm.sources))])


def said_of_tip(robot: Robot) -> str:
    """Return the link that is steered, and which others move along with it."""
    others = [link for link in robot.links_of_tip if link != robot.tip_frame]
    return f"tip: '{robot.tip_frame}'" + (
        f'; --tip steers another link, of the same hand {known(others)}' if others else '')


def several_tips(urdf: str) -> str:
    """Return a sentence about the tips of a URDF with several arms; empty for one.

    Raises:
        PlannerError: it cannot be read.
    """
    tips = likely_tips(urdf_in(resolve(urdf)))
    return '' if not tips else (f'the URDF has {len(tips)} arms; to plan for them as one body '
                                f'add  --tips {shlex.join(tips)}')


def draw(path: Path, arm: Arm, say: Callable[[str], object]) -> None:
    """Write a picture of an arm at its start: collision geometry and capsules.

    Args:
        path: PNG or SVG file.
        arm: the arm.
        say: takes a sentence if meshes are missing in the picture.

    Raises:
        PlannerError: it cannot be written.
    """
    points: list[tuple[str, Array]] = []
    if arm.parameters.urdf:
        try:
            points = [(piece.link, piece.points) for piece in collision_pieces(
                arm.robot, urdf_folder(arm.parameters))]
        except RobotError as error:
            say(f'no meshes in the picture: {error}')
    try:
        robot_picture(path, arm.robot, arm.posture, points)
    except (OSError, ValueError) as error:
        raise PlannerError(f"the picture '{path}' cannot be made: {error}") from None


def add_arm_options(parser: argparse.ArgumentParser, beside: str) -> None:
    """Add the options that say which arm of a URDF is meant.

    Args:
        parser: of the command.
        beside: the file that an expanded xacro file is put beside, for the help.
    """
    parser.add_argument('--xacro-args', nargs='+', default=[], metavar='NAME:=VALUE',
                        help='for a URDF that ends with .xacro, which is expanded to a file '
                             f'beside the {beside}')
    parser.add_argument('--tip', default='',
                        help='link that is the end effector; the end of the longest chain, '
                             'before its hand, if not given')
    parser.add_argument('--tips', default=[], nargs='+', metavar='TIP',
                        help='such links of a body with several arms, instead of --tip')
    parser.add_argument('--base', default='', help='base link; the root if not given')


def main(args: list[str] | None = None) -> int:
    """Run show_robot; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='show_robot', description=__doc__)
    parser.add_argument('--urdf', default='',
                        help='path, file:// or package:// location of the URDF')
    parser.add_argument('--params', type=Path, help='parameter file of the robot instead')
    add_arm_options(parser, 'picture')
    parser.add_argument('--posture', type=float, nargs='+', metavar='Q',
                        help='joint positions to draw and to start at; those of the file given, '
                             'or else a proposal, if not given')
    parser.add_argument('--out', type=Path, default=Path('robot.png'),
                        help='picture to write, PNG or SVG (default: %(default)s)')
    options = parser.parse_args(args)
    console = Console(stderr=True)

    def warn(sentence: str) -> None:
        console.print(f'careful: {sentence}', style='yellow')

    try:
        described = _described(options, warn)
        began = time.monotonic()
        arm = arm_of(described, warn, options.posture)
        fits: Sequence[Fit] = ()
        if arm.parameters.link_shapes == 'fitted' and not arm.parameters.capsules:
            fits = fitted_capsules(
                arm.robot, urdf_folder(arm.parameters), held=arm.parameters.locked)
        draw(options.out, arm, warn)
        console.print(_table(arm.robot, fits, time.monotonic() - began))
        console.print(said_of_limits(arm), highlight=False, markup=False, soft_wrap=True)
        if not options.tip and not arm.parameters.tips:
            console.print(said_of_tip(arm.robot), highlight=False, markup=False, soft_wrap=True)
        console.print(f'picture: {options.out}')
        print(parameter_file(arm.parameters, arm.robot, arm.start, arm.sources), end='')
    except PlannerError as error:
        print(f'show_robot: {error}', file=sys.stderr)
        return 2
    return 0


def _described(options: argparse.Namespace, warn: Callable[[str], object]) -> Described:
    if options.tip and options.tips:
        raise PlannerError('give --tip or --tips, not both')
    if options.params is not None:
        return described_by_file(
            options.params, options.urdf, options.tip, options.base, options.tips)
    if not options.urdf:
        raise PlannerError('give --urdf or --params')
    urdf = expanded(options.urdf, options.xacro_args, options.out.parent)
    if not (options.tip or options.tips) and (sentence := several_tips(urdf)):
        warn(sentence)
    return described_by_urdf(urdf, options.tip, options.base, warn, options.tips)


def _table(robot: Robot, fits: Sequence[Fit], seconds: float) -> Table:
    tips = ' and '.join(robot.tips)
    table = Table(title=f"'{robot.name}' from {robot.base_frame} to {tips}: "
                        f'{robot.n} joints, {len(robot.capsules)} capsules, {seconds:.1f} s')
    for heading in ('joint', 'links', 'corners', 'capsules', 'volume ratio'):
        table.add_column(heading)
    for fit in fits:
        table.add_row(fit.joint, ', '.join(fit.links[:3]) + (' …' if len(fit.links) > 3 else ''),
                      str(fit.corners), str(len(fit.capsules)), f'{fit.ratio:.2f}')
    return table


if __name__ == '__main__':
    raise SystemExit(main())

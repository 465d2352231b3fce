"""A robot as it stands in a parameter file: which URDF, which chain, which shapes.

The same file serves the nodes (`--params-file`) and everything offline.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import yaml

from redundant_planner.core.cache_folder import cache_folder
from redundant_planner.core.errors import known, ParameterError
from redundant_planner.core.parameters import ros_name, spec_of
from redundant_planner.core.robot.model import Capsule, Robot
from redundant_planner.core.robot.simulated_arm import joint_ranges
from redundant_planner.core.robot.urdf import Joint, read_urdf
from redundant_planner.io.link_shapes import capsule_entry, fitted_capsules, links_without_shape
from redundant_planner.io.parameter_files import (
    check_keys,
    entries_of,
    read_robot_parameters,
    RobotParameters,
    settings_of,
    urdf_folder,
    urdf_text,
)

# What forks after this many joints is a hand.
_ARM_JOINTS = 6


def build_robot(
    parameters: RobotParameters, urdf: str, capsules: Mapping[str, Mapping[str, Any]], *,
    folder: Path | None = None, say: Callable[[str], object] | None = None,
    warn: Callable[[str], object] | None = None,
) -> Robot:
    """Return the robot that parameters, URDF text and capsule entries describe.

    Args:
        parameters: from a node or a file.
        urdf: the URDF's text.
        capsules: name → {frame, start, end, radius}.
        folder: that a relative `parameters.urdf` refers to.
        say: takes a sentence before something that lasts some seconds.
        warn: takes a sentence about links that nothing protects.

    Raises:
        RobotError, ObstacleError, ParameterError: with what is wrong.
    """
    p = parameters
    if not p.tip_frame:
        raise ParameterError("parameter 'tip_frame' is empty; name the URDF link that is the "
                             'end effector')

    def robot_with(shapes: Sequence[Capsule] | None) -> Robot:
        return Robot(
            urdf, p.tip_frame, base_frame=p.base_frame,
            locked_positions=dict(zip(p.locked_joints, p.locked_positions)),
            axes=p.axes, command_frame=p.command_frame, velocity_max=p.velocity_max or None,
            acceleration_max=p.acceleration_max, capsules=shapes, link_radius=p.link_radius)

    if p.capsules:
        return robot_with([_capsule(name, capsules.get(name, {})) for name in p.capsules])
    if p.link_shapes == 'straight':
        return robot_with(None)
    bare = robot_with([])
    if say is not None:
        kept = ('once for all starts to come' if cache_folder() is not None else
                'at every start: there is no cache folder that nobody else can write to')
        say(f"fitting capsules to the URDF's collision geometry, {kept}")
    fits = fitted_capsules(bare, urdf_folder(p, folder))
    if warn is not None and (unprotected := links_without_shape(bare)):
        warn(f'no collision geometry, so nothing keeps obstacles away: {known(unprotected)}')
    return robot_with([capsule for fit in fits for capsule in fit.capsules])


def joints_to_measure(parameters: RobotParameters, urdf: str) -> tuple[str, ...]:
    """Return the joints that are locked where they are found; none if that is not wanted.

    Those are the movable joints of the URDF that are neither in the chain nor locked by name.

    Raises:
        RobotError, ParameterError: as `build_robot`.
    """
    if not parameters.lock_where_measured:
        return ()
    chain = build_robot(replace(parameters, capsules=(), link_shapes='straight'), urdf, {})
    return tuple(name for name in joint_ranges(urdf).names
                 if name not in chain.joint_names and name not in parameters.locked_joints)


def locked_at(parameters: RobotParameters, positions: Mapping[str, float]) -> RobotParameters:
    """Return the parameters with more joints locked: name → position [rad, m]."""
    return replace(
        parameters, locked_joints=(*parameters.locked_joints, *positions),
        locked_positions=(*parameters.locked_positions, *positions.values()))


def load_robot(path: Path, **changes: Any) -> Robot:
    """Return the robot of a ROS parameter file.

    Args:
        path: a file with `/**: ros__parameters:` at its top.
        changes: fields of RobotParameters that replace those of the file.

    Raises:
        PlannerError: the file is unusable, with what is wrong.
    """
    parameters, capsules = read_robot_parameters(path)
    parameters = replace(parameters, **changes)
    urdf = urdf_text(parameters, path.parent)
    if not urdf:
        raise ParameterError(f"'{path}' gives no robot: set 'urdf'")
    return build_robot(parameters, urdf, capsules, folder=path.parent)


def robot_of_values(values: Mapping[str, Any]) -> Robot:
    """Return the robot of parameter values that hold its URDF (`parameter_file_text`).

    Raises:
        PlannerError: they do not make a robot.
    """
    parameters = settings_of(RobotParameters, values)
    return build_robot(parameters, urdf_text(parameters), entries_of(values, 'capsule'))


def _capsule(name: str, entry: Mapping[str, Any]) -> Capsule:
    check_keys(f"capsule '{name}'", entry, ('frame', 'start', 'end', 'radius'))
    return Capsule(name, str(entry['frame']), entry['start'], entry['end'], entry['radius'])


def likely_tip(urdf: str) -> str:
    """Return the link that is probably the end effector.

    It lies at the end of the chain with the most movable joints, or before the hand: where,
    after six joints or more, several joints hang from one link or a joint mimics another.

    Raises:
        RobotError: the URDF does not describe a robot.
    """
    described = read_urdf(urdf)
    below: dict[str, list[Joint]] = {}
    for joint in described.joints:
        below.setdefault(joint.parent, []).append(joint)
    count, order = {described.root: 0}, [described.root]
    for link in order:  # grows meanwhile: every link comes after the one that it hangs from
        for joint in below.get(link, ()):
            count[joint.child] = count[link] + (joint.kind != 'fixed')
            order.append(joint.child)
    # The end that each link leads to, and how many joints lie before it.
    ends: dict[str, tuple[int, str]] = {}
    for link in reversed(order):
        best = count[link], link
        branches = below.get(link, [])
        several = sum(joint.kind != 'fixed' for joint in branches) > 1
        if count[link] < _ARM_JOINTS or not (
                several or any(joint.mimic is not None for joint in branches)):
            for joint in branches:
                found = ends[joint.child]
                if joint.mimic is None and (
                        found[0] > best[0] or (found[0] == best[0] and joint.kind == 'fixed')):
                    best = found
        ends[link] = best
    return ends[described.root][1]


def parameter_file_text(
    parameters: RobotParameters, robot: Robot, static: Mapping[str, Mapping[str, Any]],
    *settings: Any,
) -> str:
    """Return a ROS parameter file that needs no other file: the URDF and all capsules are in it.

    Args:
        parameters: as the robot was built with.
        robot: the robot.
        static: entries of the static obstacles.
        settings: further parameter dataclasses.
    """
    values: dict[str, Any] = {}
    for group in (parameters, *settings):
        values |= {ros_name(entry): getattr(group, entry.name) for entry in fields(group)
                   if spec_of(entry).node}
    values |= {'urdf': '', 'robot_description': robot.urdf,
               'capsules': [c.name for c in robot.capsules],
               'capsule': {c.name: capsule_entry(c) for c in robot.capsules},
               'static_obstacle': {name: dict(entry) for name, entry in static.items()}}
    values = {key: list(value) if isinstance(value, tuple) else value
              for key, value in values.items()}
    # In C where there is such: the planner does this between two ticks.
    dumper = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)
    return str(yaml.dump({'/**': {'ros__parameters': values}}, Dumper=dumper, sort_keys=False))

"""An arm and obstacles as coal has them, for judges and for what is compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.obstacles.obstacle import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    HALF_SPACE,
    Obstacle,
)
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.pinocchio_model import link_id
from redundant_planner.io.mesh_units import with_meshes_in_metres

Array = npt.NDArray[np.float64]
Pairs = Sequence[tuple[int, int]]

# coal knows no shapes without size [m].
_LEAST_SIZE = 1e-6
# Where the Panda's fingers are: open as far as they go [m].
_FINGERS = 0.04


@dataclass(frozen=True)
class Bodies:
    """An arm's rigid shapes.

    Attributes:
        model: the chain of joints.
        names: of the c shapes.
        links: the links that carry them.
        joints: (c,) Pinocchio's indices of the joints that carry them.
        placements: of the shapes in these joints' frames.
        shapes: as coal has them.
        self_pairs: indices of the shapes that shall not meet.
    """

    model: pin.Model
    names: tuple[str, ...]
    links: tuple[str, ...]
    joints: tuple[int, ...]
    placements: tuple[pin.SE3, ...]
    shapes: tuple[coal.ShapeBase, ...]
    self_pairs: Pairs


def capsules_of(robot: Robot) -> Bodies:
    """Return the capsules that the planner keeps from obstacles."""
    model = robot.model
    names, links, joints, placements, shapes = [], [], [], [], []
    for capsule in robot.capsules:
        frame = model.frames[link_id(model, capsule.frame)]
        start, end = (frame.placement.act(np.array(p)) for p in (capsule.start, capsule.end))
        names.append(capsule.name)
        links.append(capsule.frame)
        joints.append(int(frame.parentJoint))
        placements.append(pin.SE3(rotation_to(end - start), 0.5 * (start + end)))
        shapes.append(coal.Capsule(max(capsule.radius, 1e-5),
                                   max(float(np.linalg.norm(end - start)), _LEAST_SIZE)))
    return Bodies(model, tuple(names), tuple(links), tuple(joints), tuple(placements),
                  tuple(shapes), [tuple(pair) for pair in robot.self_pairs.tolist()])


def meshes_of(robot: Robot, urdf: Path) -> Bodies:
    """Return the convex collision meshes of an arm, its fingers open.

    Links that shall not meet are those whose capsules shall not.

    Args:
        robot: the arm.
        urdf: the file it was read from: its packages lie in a folder above.
    """
    text = with_meshes_in_metres(urdf.read_text(), urdf.parent)
    model = pin.buildModelFromXML(text)
    geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
    posture = pin.neutral(model)
    for name in model.names:
        if 'finger' in name:
            posture[model.joints[model.getJointId(name)].idx_q] = _FINGERS
    others = [model.getJointId(name) for name in list(model.names)[1:]
              if name not in robot.joint_names]
    model, geometry = pin.buildReducedModel(model, geometry, others, posture)
    if tuple(model.names)[1:] != robot.joint_names:
        raise ValueError(f'{urdf} has the joints {tuple(model.names)[1:]}, the arm has '
                         f'{robot.joint_names}')
    items = geometry.geometryObjects
    links = tuple(model.frames[item.parentFrame].name for item in items)
    return Bodies(
        model, links, links, tuple(int(item.parentJoint) for item in items),
        tuple(item.placement for item in items),
        tuple(_convex(item.geometry) for item in items), _link_pairs(robot, links))


def _link_pairs(robot: Robot, links: tuple[str, ...]) -> Pairs:
    """Return the pairs of links whose capsules shall not meet; fingers count as the hand."""
    frames = [capsule.frame for capsule in robot.capsules]
    apart = {frozenset((frames[i], frames[j])) for i, j in robot.self_pairs.tolist()}
    kept = [link if link in frames else frames[-1] for link in links]
    return [(i, j) for i in range(len(links)) for j in range(i)
            if frozenset((kept[i], kept[j])) in apart]


def _convex(geometry: coal.CollisionGeometry) -> coal.ShapeBase:
    """Return a mesh's hull; with the Panda's meshes, which are convex, that is the mesh."""
    if not isinstance(geometry, coal.BVHModelBase):
        return geometry
    geometry.buildConvexHull(True, 'Qt')
    return geometry.convex


def shape_of(obstacle: Obstacle) -> coal.ShapeBase:
    """Return an obstacle as coal has it, around its own centre and axes."""
    x, y, z = obstacle.half_extents.tolist()
    if obstacle.shape == ELLIPSOID:
        return coal.Ellipsoid(x, y, z)
    if obstacle.shape == BOX:
        return coal.Box(2.0 * x, 2.0 * y, 2.0 * z)
    if obstacle.shape == CYLINDER:
        return coal.Cylinder(x, 2.0 * z)
    if obstacle.shape == CAPSULE:
        return coal.Capsule(x, max(2.0 * (z - x), _LEAST_SIZE))
    if obstacle.shape == HALF_SPACE:
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    raise ValueError(f"obstacle '{obstacle.name}' is a {obstacle.shape}, which coal is not "
                     'told how to make')


def rotation_to(direction: Array) -> Array:
    """Return a rotation that takes z to `direction`."""
    size = float(np.linalg.norm(direction))
    if size < 1e-9:
        return np.eye(3)
    return pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction / size).matrix()

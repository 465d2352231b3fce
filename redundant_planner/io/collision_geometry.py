"""The collision geometry of a URDF's links, as points around it and radii where it is round."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import NamedTuple
import xml.etree.ElementTree as ElementTree

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.errors import known, PlannerError, RobotError
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.urdf import LARGEST, Numbers, numbers, read_urdf
from redundant_planner.io.mesh_units import mesh_scale
from redundant_planner.io.resources import resolve

Array = npt.NDArray[np.float64]

# Corners of the polygon around a cylinder's rim.
_RIM = 24
# Of collision elements on one joint and on all of them: neighbours to merge are searched for
# among all pairs on a joint, and with more than this that takes minutes.
MOST_ON_JOINT, _MOST_ELEMENTS = 100, 250
# The shapes that a capsule can be fitted to, with their attributes and how many numbers each has.
_SIZES = {'sphere': {'radius': 1}, 'box': {'size': 3}, 'cylinder': {'radius': 1, 'length': 1},
          'capsule': {'radius': 1, 'length': 1}}


class CollisionElement(NamedTuple):
    """One collision element of a link, as the URDF has it.

    Attributes:
        link: its name.
        joint: name of the chain joint that carries it; the base frame's of what stands still.
        xyz, rpy: (3,) the shape in the link's frame [m, rad].
        kind: sphere, box, cylinder, capsule or mesh.
        sizes: of the shape [m]; a mesh's scale, its file's unit included.
        mesh: the file, empty for the other shapes.
    """

    link: str
    joint: str
    xyz: Numbers
    rpy: Numbers
    kind: str
    sizes: Numbers
    mesh: str


class Piece(NamedTuple):
    """One collision element of a link.

    Attributes:
        link: its name.
        joint: name of the chain joint that carries it; the base frame's of what stands still.
        points: (k, 3) corners of a body around it, in the link's frame [m].
        radius: of a sphere or capsule, whose points are the ends of its segment [m]; None for
            a body.
    """

    link: str
    joint: str
    points: Array
    radius: float | None = None


def collision_pieces(robot: Robot, folder: Path | None) -> list[Piece]:
    """Return the collision elements of all links that the chain's joints move, and of its base.

    Raises:
        RobotError: a collision element or mesh cannot be used, or there is none.
    """
    return [piece_of(element) for element in collision_elements(robot, folder)]


def links_without_shape(robot: Robot) -> list[str]:
    """Return the moving links that can be seen but have no collision geometry."""
    links = read_urdf(robot.urdf).links
    return [name for name in robot.moving_links if name in links
            and links[name].find('visual') is not None and links[name].find('collision') is None]


def collision_elements(robot: Robot, folder: Path | None) -> list[CollisionElement]:
    """Read every collision element of the moving links, and of what is fixed to the base.

    Links beyond joints that are held still by others have none: they may come to stand elsewhere.
    """
    described = read_urdf(robot.urdf)
    links, base = described.links, robot.base_frame
    carriers = robot.moving_links | dict.fromkeys(described.rigid_with(base), base)
    elements = [_element(collision, link, joint, folder)
                for link, joint in carriers.items() if link in links
                for collision in links[link].findall('collision')]
    counts = Counter(element.joint for element in elements if element.joint != base)
    if not counts:
        raise RobotError(
            'no moving link of the URDF has collision geometry to fit capsules to; list '
            "capsules, or give a link_radius (in a file with 'link_shapes: straight')")
    joint, most = counts.most_common(1)[0]
    if most > MOST_ON_JOINT or counts.total() > _MOST_ELEMENTS:
        raise RobotError(
            f'the links that joint {joint!r} carries have {most} collision elements, all moving '
            f'links {counts.total()}; capsules are fitted to {MOST_ON_JOINT} and '
            f'{_MOST_ELEMENTS} at most: list capsules, or simplify the geometry')
    return elements


def _element(
    collision: ElementTree.Element, link: str, joint: str, folder: Path | None,
) -> CollisionElement:
    what = f"collision geometry of link '{link}'"
    origin = collision.find('origin')
    zero = (0.0, 0.0, 0.0)
    xyz, rpy = (numbers(origin, key, f'the origin of the {what}', default=zero)
                for key in ('xyz', 'rpy'))
    shapes = [shape for geometry in collision.findall('geometry') for shape in geometry]
    if len(shapes) != 1:
        raise RobotError(f'a <collision> of the {what} holds {len(shapes)} shapes; it takes one')
    (shape,) = shapes
    if shape.tag == 'mesh':
        try:
            mesh = resolve(shape.get('filename', ''), folder)
        except PlannerError as error:
            raise RobotError(f"mesh of link '{link}': {error}") from None
        scale = mesh_scale(shape, mesh, f"the mesh of link '{link}'")
        return CollisionElement(link, joint, xyz, rpy, 'mesh', scale, str(mesh))
    if shape.tag not in _SIZES:
        raise RobotError(f"the {what} has a <{shape.tag[:60]}>, which no capsule can be fitted "
                         f"to; it takes {known([*_SIZES, 'mesh'])}")
    sizes = tuple(size for key, count in _SIZES[shape.tag].items() for size in numbers(
        shape, key, f'the {shape.tag} in the {what}', count=count))
    if min(sizes) <= 0.0:
        raise RobotError(f'the {shape.tag} in the {what} has the sizes {list(sizes)}; they must '
                         'be positive')
    return CollisionElement(link, joint, xyz, rpy, shape.tag, sizes, '')


def piece_of(element: CollisionElement) -> Piece:
    """Return points around an element in its link's frame, and a radius where it is round."""
    points, radius = _corners(element)
    points = points @ pin.rpy.rpyToMatrix(*element.rpy).T + np.array(element.xyz)
    return Piece(element.link, element.joint, points, radius)


def _corners(element: CollisionElement) -> tuple[Array, float | None]:
    """Return points around an element in its own frame, and a radius where it is round."""
    sizes = element.sizes
    if element.kind == 'mesh':
        return _vertices(element), None
    if element.kind == 'box':
        signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T
        return 0.5 * signs * np.array(sizes), None
    if element.kind == 'cylinder':
        turn = np.linspace(0.0, 2.0 * np.pi, _RIM, endpoint=False)
        rim = sizes[0] / np.cos(np.pi / _RIM) * np.column_stack((np.cos(turn), np.sin(turn)))
        return np.vstack([np.column_stack((rim, np.full(_RIM, z)))
                          for z in (-0.5 * sizes[1], 0.5 * sizes[1])]), None
    end = np.array((0.0, 0.0, 0.5 * sizes[1] if element.kind == 'capsule' else 0.0))
    return np.array((-end, end)), sizes[0]


def _vertices(element: CollisionElement) -> Array:
    """Read the vertices (k, 3) of an element's mesh [m].

    Raises:
        RobotError: the mesh is unreadable, empty, or its corners are no places near an arm.
    """
    robot = ElementTree.Element('robot', name='mesh')
    link = ElementTree.SubElement(robot, 'link', name='mesh')
    geometry = ElementTree.SubElement(ElementTree.SubElement(link, 'collision'), 'geometry')
    ElementTree.SubElement(geometry, 'mesh', filename=element.mesh,
                           scale=' '.join(map(repr, element.sizes)))
    text = ElementTree.tostring(robot, encoding='unicode')
    what = f"mesh of link '{element.link}': '{element.mesh}'"
    try:
        (found,) = pin.buildGeomFromUrdfString(
            pin.buildModelFromXML(text), text, pin.GeometryType.COLLISION).geometryObjects
        shape = found.geometry
        points = shape.vertices() if hasattr(shape, 'vertices') else shape.points()
    except (ValueError, RuntimeError, AttributeError, TypeError) as error:
        # Pinocchio's own words begin with where it is in its sources.
        words = (str(error).partition('message: ')[2] or str(error)).splitlines() or ['']
        raise RobotError(f'{what} cannot be read: {words[0]}') from None
    points = np.array(points, dtype=float).reshape(-1, 3)
    if not len(points) or not (np.abs(points) <= LARGEST).all():
        raise RobotError(f'{what} has {len(points)} vertices; it takes some, all of them within '
                         f'±{LARGEST:g} m')
    return points

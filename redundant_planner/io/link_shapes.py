"""Capsules for an arm's links, fitted to the collision geometry of its URDF."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
import contextlib
from dataclasses import dataclass
import hashlib
import json
import os
from pathlib import Path
import tempfile
from typing import Any, NamedTuple
import xml.etree.ElementTree as ElementTree

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.cache_folder import cache_folder
from redundant_planner.core.errors import known, PlannerError, RobotError
from redundant_planner.core.robot.model import Capsule, Robot
from redundant_planner.core.robot.urdf import LARGEST, Numbers, numbers, read_urdf
from redundant_planner.io.resources import resolve

Array = npt.NDArray[np.float64]

# Corners of the polygon around a cylinder's rim.
_RIM = 24
# Of collision elements on one joint and on all of them: neighbours to merge are searched for
# among all pairs on a joint, and with more than this that takes minutes.
_MOST_ON_JOINT, _MOST_ELEMENTS = 100, 250
# Changes when the fit does, so that older results in the cache are not taken for its own.
_VERSION = 2
# The shapes that a capsule can be fitted to, with their attributes and how many numbers each has.
_SIZES = {'sphere': {'radius': 1}, 'box': {'size': 3}, 'cylinder': {'radius': 1, 'length': 1},
          'capsule': {'radius': 1, 'length': 1}}


class _Element(NamedTuple):
    """One collision element of a link, as the URDF has it.

    Attributes:
        link: its name.
        joint: name of the chain joint that carries it.
        xyz, rpy: (3,) the shape in the link's frame [m, rad].
        kind: sphere, box, cylinder, capsule or mesh.
        sizes: of the shape [m]; a mesh's scale.
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
        joint: name of the chain joint that carries it.
        points: (k, 3) corners of a body around it, in the link's frame [m].
        radius: of a sphere or capsule, whose points are the ends of its segment [m]; None for
            a body.
    """

    link: str
    joint: str
    points: Array
    radius: float | None = None


@dataclass(frozen=True)
class Fit:
    """What a fit made of the links that one joint carries.

    Attributes:
        joint: its name.
        links: theirs.
        capsules: around them.
        corners: points that had to be enclosed.
        ratio: volume of the capsules over that of the convex bodies; infinite for flat ones.
    """

    joint: str
    links: tuple[str, ...]
    capsules: tuple[Capsule, ...]
    corners: int
    ratio: float


def fitted_capsules(robot: Robot, folder: Path | None, *, cache: bool = True) -> tuple[Fit, ...]:
    """Return capsules around every link that the chain's joints move.

    Args:
        robot: the arm, its own capsules do not matter.
        folder: of the URDF, for relative mesh paths.
        cache: whether a fit of the same URDF and meshes is looked up and kept (`cache_folder`).

    Raises:
        RobotError: a collision element or mesh cannot be used, or no link has any.
    """
    elements = _elements(robot, folder)
    kept = cache_folder() if cache else None
    if kept is None:
        return tuple(_fit(robot, map(_piece, elements)))
    key = _key(robot, elements)
    file = kept / f'capsules-{key[:32]}.txt'
    fits = _read(file, key, elements)
    if fits is None:
        fits = tuple(_fit(robot, map(_piece, elements)))
        _write(file, key, fits)
    return fits


def collision_pieces(robot: Robot, folder: Path | None) -> list[Piece]:
    """Return the collision elements of all links that the chain's joints move.

    Raises:
        RobotError: a collision element or mesh cannot be used, or there is none.
    """
    return [_piece(element) for element in _elements(robot, folder)]


def links_without_shape(robot: Robot) -> list[str]:
    """Return the moving links that can be seen but have no collision geometry."""
    links = read_urdf(robot.urdf).links
    return [name for name in robot.moving_links if name in links
            and links[name].find('visual') is not None and links[name].find('collision') is None]


def _elements(robot: Robot, folder: Path | None) -> list[_Element]:
    """Read every collision element of the moving links; none is left out."""
    links = read_urdf(robot.urdf).links
    elements = [_element(collision, link, joint, folder)
                for link, joint in robot.moving_links.items() if link in links
                for collision in links[link].findall('collision')]
    if not elements:
        raise RobotError(
            'no moving link of the URDF has collision geometry to fit capsules to; list '
            "capsules, or give a link_radius (in a file with 'link_shapes: straight')")
    joint, most = Counter(element.joint for element in elements).most_common(1)[0]
    if most > _MOST_ON_JOINT or len(elements) > _MOST_ELEMENTS:
        raise RobotError(
            f'the links that joint {joint!r} carries have {most} collision elements, all moving '
            f'links {len(elements)}; capsules are fitted to {_MOST_ON_JOINT} and '
            f'{_MOST_ELEMENTS} at most: list capsules, or simplify the geometry')
    return elements


def _element(
    collision: ElementTree.Element, link: str, joint: str, folder: Path | None,
) -> _Element:
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
        scale = numbers(shape, 'scale', f"the mesh of link '{link}'", default=(1.0, 1.0, 1.0))
        if 0.0 in scale:
            raise RobotError(f"the mesh of link '{link}' has a scale of 0")
        return _Element(link, joint, xyz, rpy, 'mesh', scale, str(mesh))
    if shape.tag not in _SIZES:
        raise RobotError(f"the {what} has a <{shape.tag[:60]}>, which no capsule can be fitted "
                         f"to; it takes {known([*_SIZES, 'mesh'])}")
    sizes = tuple(size for key, count in _SIZES[shape.tag].items() for size in numbers(
        shape, key, f'the {shape.tag} in the {what}', count=count))
    if min(sizes) <= 0.0:
        raise RobotError(f'the {shape.tag} in the {what} has the sizes {list(sizes)}; they must '
                         'be positive')
    return _Element(link, joint, xyz, rpy, shape.tag, sizes, '')


def _piece(element: _Element) -> Piece:
    """Return points around an element in its link's frame, and a radius where it is round."""
    points, radius = _corners(element)
    points = points @ pin.rpy.rpyToMatrix(*element.rpy).T + np.array(element.xyz)
    return Piece(element.link, element.joint, points, radius)


def _corners(element: _Element) -> tuple[Array, float | None]:
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


def _vertices(element: _Element) -> Array:
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


def _fit(robot: Robot, pieces: Iterable[Piece]) -> Iterable[Fit]:
    from redundant_planner.core.robot.capsule_fit import convex_hull, fit_body, merged, Shape

    by_joint: dict[str, list[Piece]] = {}
    for piece in pieces:
        by_joint.setdefault(piece.joint, []).append(piece)
    for joint in (name for name in robot.joint_names if name in by_joint):
        group = by_joint[joint]
        base = group[0].link
        shapes, owners, volume, corners = [], [], 0.0, 0
        for piece in group:
            # All in the frame of the joint's first link: they are one rigid body.
            points = robot.in_link(base, piece.link, piece.points)
            corners += len(points)
            if piece.radius is not None:
                shape = Shape(points[0], points[1], piece.radius)
                shapes.append((shape, np.vstack([_around(end, piece.radius) for end in points])))
                owners.append(piece.link)
                volume += shape.volume
                continue
            body = convex_hull(points)
            volume += body.volume
            parts = fit_body(body)
            shapes += parts
            owners += [piece.link] * len(parts)
        capsules: list[Capsule] = []
        for shape, _, members in merged(shapes):
            name = owners[members[0]]
            taken = sum(c.name == name or c.name.startswith(f'{name}_') for c in capsules)
            # Outwards by what is lost when the numbers are written down.
            radius = shape.radius + 1e-5
            capsules.append(Capsule(f'{name}_{taken + 1}' if taken else name, base,
                                    np.round(shape.start, 5), np.round(shape.end, 5),
                                    float(np.ceil(radius * 1e5) / 1e5)))
        total = sum(Shape(c.start, c.end, c.radius).volume for c in capsules)
        yield Fit(joint, tuple(dict.fromkeys(p.link for p in group)), tuple(capsules), corners,
                  total / volume if volume > 0.0 else np.inf)


def _around(center: Array, radius: float) -> Array:
    """Return the corners (20, 3) of a dodecahedron around a ball."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T.astype(float)
    flat = signs[signs[:, 0] > 0] * np.array((0.0, 1.0 / golden, golden))
    corners = np.vstack((signs, *(np.roll(flat, i, axis=1) for i in range(3))))
    inner = golden ** 2 / np.sqrt(3.0 - golden) / 2.0 * (2.0 / golden)
    return center + corners * (radius / inner)


def _key(robot: Robot, elements: Sequence[_Element]) -> str:
    """Return what tells one fit from another."""
    digest = hashlib.sha256(f'{_VERSION} {robot.joint_names} {elements}'.encode())
    first: dict[str, str] = {}
    for element in elements:
        # Links on one joint are one body: how they stand to each other matters.
        base = first.setdefault(element.joint, element.link)
        digest.update(robot.in_link(base, element.link, np.eye(4, 3)).tobytes())
        if element.mesh:
            with contextlib.suppress(OSError):  # it is gone: reading it will say so
                status = os.stat(element.mesh)
                digest.update(f'{status.st_size} {status.st_mtime_ns}'.encode())
    return digest.hexdigest()


def _read(file: Path, key: str, elements: Sequence[_Element]) -> tuple[Fit, ...] | None:
    """Return the fits that a file holds, None if there is none, or not as it was written."""
    try:
        seal, _, content = file.read_bytes().partition(b'\n')
        if seal != _seal(key, content):
            return None
        fits = tuple(_fit_of(entry) for entry in json.loads(content))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    links: dict[str, dict[str, None]] = {}
    for element in elements:
        links.setdefault(element.joint, {})[element.link] = None
    covered = {fit.joint: dict.fromkeys(fit.links) for fit in fits if fit.capsules}
    return fits if covered == links else None


def _write(file: Path, key: str, fits: Sequence[Fit]) -> None:
    """Keep fits for the next start, whole or not at all."""
    content = json.dumps([
        {'joint': fit.joint, 'links': fit.links, 'corners': fit.corners, 'ratio': fit.ratio,
         'capsules': [capsule_entry(c) | {'name': c.name} for c in fit.capsules]}
        for fit in fits]).encode()
    # A folder that cannot be written to costs some seconds at the next start.
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=file.parent)
        try:
            with os.fdopen(handle, 'wb') as stream:
                stream.write(_seal(key, content) + b'\n' + content)
            os.replace(name, file)
        except OSError:
            Path(name).unlink(missing_ok=True)


def _seal(key: str, content: bytes) -> bytes:
    """Return a digest that no damaged content has, nor that of another arm."""
    return hashlib.sha256(key.encode() + content).hexdigest().encode()


def _fit_of(entry: dict[str, Any]) -> Fit:
    return Fit(
        entry['joint'], tuple(entry['links']),
        tuple(Capsule(c['name'], c['frame'], c['start'], c['end'], c['radius'])
              for c in entry['capsules']),
        int(entry['corners']), float(entry['ratio']))


def capsule_entry(capsule: Capsule) -> dict[str, Any]:
    """Return a capsule as it stands in a parameter file."""
    return {'frame': capsule.frame, 'start': capsule.start.tolist(),
            'end': capsule.end.tolist(), 'radius': capsule.radius}

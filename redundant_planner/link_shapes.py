"""Capsules for an arm's links, fitted to the collision geometry of its URDF."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import hashlib
import json
import os
from pathlib import Path
from typing import Any, NamedTuple
import xml.etree.ElementTree as ElementTree

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.errors import PlannerError, RobotError
from redundant_planner.core.robot import Capsule, Robot, tell_apart
from redundant_planner.resources import resolve

Array = npt.NDArray[np.float64]

# Corners of the polygon around a cylinder's rim.
_RIM = 24
# Changes when the fit does, so that older results in the cache are not taken for its own.
_VERSION = 1


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
        cache: whether a fit of the same URDF and meshes is looked up and kept
            ($XDG_CACHE_HOME/redundant_planner).

    Raises:
        RobotError: a mesh is missing or unreadable, or no link has collision geometry.
    """
    text, meshes = _collision_urdf(robot, folder)
    file = _cache_file(robot, text, meshes)
    if cache:
        try:
            return _from_json(json.loads(file.read_text()))
        except (OSError, ValueError, KeyError, TypeError):
            pass  # not there, or not ours: fit again
    fits = tuple(_fit(robot, collision_pieces(robot, folder)))
    if cache:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps(_to_json(fits)))
        except OSError:
            pass  # a home that cannot be written to costs some seconds at the next start
    return fits


def collision_pieces(robot: Robot, folder: Path | None) -> list[Piece]:
    """Return the collision elements of all links that the chain's joints move.

    Raises:
        RobotError: a mesh is missing or unreadable, or there is no collision geometry.
    """
    text, _ = _collision_urdf(robot, folder)
    model = pin.buildModelFromXML(text)
    try:
        geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
    except (ValueError, RuntimeError) as error:
        raise RobotError(f'the collision geometry cannot be read: {error}') from None
    carriers = robot.moving_links
    pieces = []
    for element in geometry.geometryObjects:
        frame = model.frames[element.parentFrame]
        if frame.name not in carriers:
            continue
        placement = frame.placement.inverse() * element.placement
        points, radius = _corners(element)
        points = points @ placement.rotation.T + placement.translation
        pieces.append(Piece(frame.name, carriers[frame.name], points, radius))
    if not pieces:
        raise RobotError(
            'no moving link of the URDF has collision geometry to fit capsules to; set '
            "link_shapes to 'straight' and link_radius, or list capsules")
    return pieces


def _collision_urdf(robot: Robot, folder: Path | None) -> tuple[str, list[Path]]:
    """Return the URDF with absolute mesh paths and nothing but the collision that matters."""
    root = ElementTree.fromstring(robot.urdf)
    tell_apart(root)
    meshes = []
    for link in root.findall('link'):
        for visual in link.findall('visual'):
            link.remove(visual)
        for collision in link.findall('collision'):
            if link.get('name') not in robot.moving_links:
                link.remove(collision)
                continue
            for mesh in collision.iter('mesh'):
                try:
                    path = resolve(mesh.get('filename', ''), folder)
                except PlannerError as error:
                    raise RobotError(f"mesh of link '{link.get('name')}': {error}") from None
                mesh.set('filename', str(path))
                meshes.append(path)
    return ElementTree.tostring(root, encoding='unicode'), meshes


def _corners(element: pin.GeometryObject) -> tuple[Array, float | None]:
    """Return points around an element in its own frame, and a radius where it is round."""
    shape = element.geometry
    kind = type(shape).__name__
    if kind == 'Sphere':
        return np.zeros((2, 3)), float(shape.radius)
    if kind == 'Capsule':
        end = np.array((0.0, 0.0, shape.halfLength))
        return np.array((-end, end)), float(shape.radius)
    if kind == 'Box':
        signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T
        return signs * np.array(shape.halfSide).ravel(), None
    if kind == 'Cylinder':
        turn = np.linspace(0.0, 2.0 * np.pi, _RIM, endpoint=False)
        rim = shape.radius / np.cos(np.pi / _RIM) * np.column_stack((np.cos(turn), np.sin(turn)))
        return np.vstack([np.column_stack((rim, np.full(_RIM, z)))
                          for z in (-shape.halfLength, shape.halfLength)]), None
    try:
        vertices = shape.vertices() if hasattr(shape, 'vertices') else shape.points()
        return np.array(vertices, dtype=float).reshape(-1, 3), None
    except (AttributeError, TypeError):
        raise RobotError(f"collision element '{element.name}' is a {kind}, which no capsule can "
                         'be fitted to; list capsules instead') from None


def _fit(robot: Robot, pieces: Iterable[Piece]) -> Iterable[Fit]:
    from redundant_planner.core.capsule_fit import convex_hull, fit_body, merged, Shape

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


def _cache_file(robot: Robot, text: str, meshes: Iterable[Path]) -> Path:
    digest = hashlib.sha256(f'{_VERSION} {robot.joint_names} {robot.moving_links} {text}'.encode())
    for mesh in meshes:
        status = mesh.stat()
        digest.update(f'{mesh} {status.st_size} {status.st_mtime_ns}'.encode())
    root = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    return root / 'redundant_planner' / f'capsules-{digest.hexdigest()[:32]}.json'


def _to_json(fits: Iterable[Fit]) -> list[dict[str, Any]]:
    return [{'joint': fit.joint, 'links': fit.links, 'corners': fit.corners, 'ratio': fit.ratio,
             'capsules': [capsule_entry(c) | {'name': c.name} for c in fit.capsules]}
            for fit in fits]


def _from_json(entries: list[dict[str, Any]]) -> tuple[Fit, ...]:
    return tuple(Fit(
        entry['joint'], tuple(entry['links']),
        tuple(Capsule(c['name'], c['frame'], np.array(c['start']), np.array(c['end']),
                      float(c['radius'])) for c in entry['capsules']),
        int(entry['corners']), float(entry['ratio'])) for entry in entries)


def capsule_entry(capsule: Capsule) -> dict[str, Any]:
    """Return a capsule as it stands in a parameter file."""
    return {'frame': capsule.frame, 'start': capsule.start.tolist(),
            'end': capsule.end.tolist(), 'radius': capsule.radius}

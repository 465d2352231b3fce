"""The collision geometry of a URDF's links as triangles, to be drawn."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.robot.model import Robot
from redundant_planner.io.mesh_units import with_meshes_in_metres

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

# Corners around what is round, and how many triangles one link may have.
_ROUND = 24
_MOST_TRIANGLES = 200_000


class LinkSurface(NamedTuple):
    """Triangles of one link.

    Attributes:
        link: its name.
        vertices: (k, 3) in the link's frame [m].
        triangles: (t, 3) indices of vertices.
    """

    link: str
    vertices: Array
    triangles: Indices


def link_surfaces(robot: Robot, folder: Path | None) -> tuple[LinkSurface, ...]:
    """Return the collision geometry of all links of an arm that has any.

    Args:
        robot: the arm.
        folder: of the URDF, for relative mesh paths.

    Raises:
        PlannerError, ValueError, RuntimeError: a mesh is not there, or cannot be read.
    """
    text = with_meshes_in_metres(robot.urdf, folder)
    model = pin.buildModelFromXML(text)
    found = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
    links = {*robot.moving_links, *robot.links_at_rest}
    surfaces = []
    for item in found.geometryObjects:
        frame = model.frames[item.parentFrame]
        if frame.name not in links:
            continue
        vertices, triangles = _triangles(item)
        if len(triangles) and len(triangles) <= _MOST_TRIANGLES:
            # An object is placed as seen from its joint, as the link's frame is.
            there = frame.placement.inverse() * item.placement
            surfaces.append(LinkSurface(
                frame.name, vertices @ there.rotation.T + there.translation, triangles))
    return tuple(surfaces)


def _triangles(item: pin.GeometryObject) -> tuple[Array, Indices]:
    """Return vertices (k, 3) and triangles (t, 3) of an object, in its own frame."""
    shape = item.geometry
    if hasattr(shape, 'num_tris'):
        vertices = np.array(shape.vertices(), dtype=float).reshape(-1, 3)
        corners = (shape.tri_indices(i) for i in range(shape.num_tris))
        return vertices, np.array(
            [(tri[0], tri[1], tri[2]) for tri in corners], dtype=np.int64).reshape(-1, 3)
    points = _points(shape)
    if points is None:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    triangles = np.array(hull.simplices, dtype=np.int64)
    a, b, c = points[triangles].transpose(1, 0, 2)
    outwards = (np.cross(b - a, c - a) * (a - points.mean(axis=0))).sum(axis=1)
    inwards = outwards < 0.0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return points, triangles


def _points(shape: object) -> Array | None:
    """Return points on a convex body's surface (k, 3), None of a kind that is not known."""
    if hasattr(shape, 'halfSide'):
        signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T
        return np.asarray(signs * np.array(shape.halfSide), dtype=float)
    radius = getattr(shape, 'radius', None)
    if radius is None:
        return None
    half = float(getattr(shape, 'halfLength', 0.0))
    around = np.linspace(0.0, 2.0 * np.pi, _ROUND, endpoint=False)
    rim = np.column_stack((np.cos(around), np.sin(around)))
    if type(shape).__name__ == 'Cylinder':
        return np.vstack([np.column_stack((radius * rim, np.full(_ROUND, z)))
                          for z in (-half, half)])
    # A ball, cut apart in the middle and drawn out for a capsule.
    rings = []
    for height in np.linspace(0.0, 0.5 * np.pi, _ROUND // 4 + 1):
        ring = np.column_stack((radius * np.cos(height) * rim,
                                np.full(_ROUND, half + radius * np.sin(height))))
        rings += [ring, ring * (1.0, 1.0, -1.0)]
    return np.unique(np.round(np.vstack(rings), 9), axis=0)

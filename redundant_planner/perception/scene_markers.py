"""What of a planning scene becomes which markers: obstacles, and what the hand holds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.marker_reader import CUBE
from redundant_planner.io.obstacle_bounds import FARTHEST
from redundant_planner.perception.scene_records import HeldObject, PlanningScene, Surroundings
from redundant_planner.perception.scene_shapes import placement, PLANE, Solid

Array = npt.NDArray[np.float64]

# Markers and cubes of the octomap that are published; planner_node keeps as many together.
MOST_MARKERS, MOST_CUBES = 10_000, 10_000
# A plane is a slab as wide and as deep as this, with the plane as its upper face [m].
_PLANE_WIDTH, _PLANE_DEPTH = 100.0, 10.0
# The arm counts as on neither side of a plane that is this close to its first joint [m].
_ON_THE_PLANE = 1e-6


class SceneMarker(NamedTuple):
    """One shape.

    Attributes:
        namespace: the object's id.
        number: of the shape in the object.
        kind: the type of the marker.
        pose: (4, 4) in its frame.
        size: (3,) full extents [m].
    """

    namespace: str
    number: int
    kind: int
    pose: Array
    size: Array


class SceneMarkers(NamedTuple):
    """All shapes of a scene.

    Attributes:
        obstacles: in the base frame.
        held: link → what it holds, in its frame; links that move along with the tip.
        cubes: edge [m] → (k, 3) centres in the frame of the octomap [m].
        remarks: a sentence for each thing that is left out.
    """

    obstacles: tuple[SceneMarker, ...]
    held: dict[str, tuple[SceneMarker, ...]]
    cubes: dict[float, Array]
    remarks: tuple[str, ...]


def obstacle_ids(scene: PlanningScene, robot: Robot) -> list[str]:
    """Return the objects that are obstacles: those of the world, and on links at rest."""
    at_rest = set(robot.links_at_rest)
    return [*scene.objects, *(name for name, held in scene.held.items() if held.link in at_rest)]


def scene_markers(scene: PlanningScene, robot: Robot, around: Surroundings) -> SceneMarkers:
    """Return the markers of a scene."""
    remarks: list[str] = []
    obstacles = [
        _marker(name, number, solid, one.pose, around.center)
        for name, one in scene.objects.items() for number, solid in enumerate(one.solids)]
    of_tip, at_rest = set(robot.links_of_tip), set(robot.links_at_rest)
    in_hand: dict[str, list[SceneMarker]] = {}
    for name, held in scene.held.items():
        try:
            if held.link in of_tip:
                in_hand.setdefault(held.link, []).extend(_in_hand(name, held, around, remarks))
            elif held.link in at_rest:
                pose = around.frame(held.link) @ held.pose
                obstacles += [_marker(name, number, solid, pose, around.center)
                              for number, solid in enumerate(held.solids)]
            else:
                raise ObstacleError(
                    f'is attached to {held.link!r}, which does not move along with the tip '
                    f'{robot.tip_frame!r}: the planner does not know of it')
        except ObstacleError as error:
            remarks.append(f'object {name!r} {error}')
    obstacles = _near(obstacles, remarks)
    if len(obstacles) > MOST_MARKERS:
        remarks.append(f'the scene has too many shapes: {MOST_MARKERS} of {len(obstacles)} count, '
                       f'not those from object {obstacles[MOST_MARKERS].namespace!r} on')
    return SceneMarkers(
        tuple(obstacles[:MOST_MARKERS]),
        {link: tuple(_near(markers, remarks)) for link, markers in in_hand.items()},
        _cubes(scene, around, remarks), tuple(remarks))


def _near(markers: list[SceneMarker], remarks: list[str]) -> list[SceneMarker]:
    """Return the markers that are near enough to be obstacles."""
    far = [marker for marker in markers if not (np.abs(marker.pose[:3, 3]) <= FARTHEST).all()]
    remarks += [f'object {marker.namespace!r} has a shape at {marker.pose[:3, 3].tolist()}: up to '
                f'{FARTHEST:g} m are taken' for marker in far]
    names = {(marker.namespace, marker.number) for marker in far}
    return [marker for marker in markers if marker[:2] not in names]


def _marker(name: str, number: int, solid: Solid, pose: Array, center: Array) -> SceneMarker:
    """Return the marker of a shape of an object with a pose in the base frame."""
    there = pose @ solid.in_object
    if solid.kind != PLANE:
        return SceneMarker(name, number, solid.kind, there, solid.size)
    # What lies behind it, seen from the arm: MoveIt's planes have no inside.
    normal = there[:3, 2]
    height = float(normal @ (center - there[:3, 3]))
    side = -1.0 if height < -_ON_THE_PLANE else 1.0
    middle = center - (height + 0.5 * side * _PLANE_DEPTH) * normal
    return SceneMarker(name, number, CUBE, placement(middle, there[:3, :3]),
                       np.array([_PLANE_WIDTH, _PLANE_WIDTH, _PLANE_DEPTH]))


def _in_hand(
    name: str, held: HeldObject, around: Surroundings, remarks: list[str],
) -> list[SceneMarker]:
    if any(solid.kind == PLANE for solid in held.solids):
        remarks.append(f'object {name!r} is held and has a plane: nobody can hold one; it is left '
                       'out')
    return [_marker(name, number, solid, held.pose, around.center)
            for number, solid in enumerate(held.solids) if solid.kind != PLANE]


def _cubes(
    scene: PlanningScene, around: Surroundings, remarks: list[str],
) -> dict[float, Array]:
    """Return the cubes of the octomap by their edges, the nearest ones to the arm."""
    if scene.voxels is None:
        return {}
    pose, (centers, edges) = scene.voxels
    if len(edges) > MOST_CUBES:
        remarks.append(f'the octomap has too many cubes: the {MOST_CUBES} nearest to the arm '
                       f'count, and {len(edges) - MOST_CUBES} more do not')
        away = np.linalg.norm(
            centers @ pose[:3, :3].T + pose[:3, 3] - around.center, axis=1)
        nearest = np.argpartition(away, MOST_CUBES)[:MOST_CUBES]
        centers, edges = centers[nearest], edges[nearest]
    return {edge: centers[edges == edge] for edge in np.unique(edges).tolist()}

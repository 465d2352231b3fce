"""An arm on the page: its links, the capsules around them, its trail and the nearest pair."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import viser

from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.quaternions import quaternion_of
from redundant_planner.io.link_surfaces import LinkSurface
from redundant_planner.io.marker_shapes import upright_to
from redundant_planner.playground.measures import NearestPair

Array = npt.NDArray[np.float64]
Color = tuple[int, int, int]

LINK, CAPSULE, GHOST = (222, 226, 232), (40, 110, 190), (150, 90, 200)
TRAIL, REFERENCE, NEAREST, TOUCHING = (20, 140, 120), (240, 170, 40), (200, 90, 40), (220, 30, 30)
# Points of a trail, and how far apart they are at least [m].
_TRAIL, _STEP = 600, 2e-3
# How far the ends of a line move until it is drawn anew [m].
_SEEN = 2e-4
_SIDES, _RINGS = 16, 5


class LinksView:
    """The links of an arm, as triangles or as capsules."""

    def __init__(
        self, scene: viser.SceneApi, name: str, robot: Robot, surfaces: Sequence[LinkSurface], *,
        color: Color = LINK, capsule_color: Color = CAPSULE, opacity: float | None = None,
    ) -> None:
        """Draw an arm.

        Args:
            scene: to draw into.
            name: of the arm in the scene, as '/arm'.
            robot: the arm.
            surfaces: of its links; none to show capsules alone.
            color: of them.
            capsule_color: of capsules.
            opacity: of both; None for links that nothing shines through.
        """
        self._robot, self._data = robot, robot.model.createData()
        self._frames, self._surfaces = [], []
        frame_of = {frame.name: i for i, frame in enumerate(robot.model.frames)
                    if frame.type == pin.FrameType.BODY}
        for i, surface in enumerate(surfaces):
            self._surfaces.append(scene.add_mesh_simple(
                f'{name}/links/{i}', surface.vertices.astype(np.float32),
                surface.triangles.astype(np.uint32), color=color, opacity=opacity,
                flat_shading=True, side='double'))
            self._frames.append(frame_of[surface.link])
        solid = not surfaces
        self._capsules = []
        for i, capsule in enumerate(robot.capsules):
            length = float(np.linalg.norm(capsule.end - capsule.start))
            vertices, triangles = capsule_surface(max(capsule.radius, 0.005), length)
            self._capsules.append(scene.add_mesh_simple(
                f'{name}/capsules/{i}', vertices, triangles,
                color=color if solid else capsule_color,
                opacity=opacity if solid else 0.35, visible=solid))
        self.has_surfaces = bool(surfaces)
        self._shown = (True, solid)
        self._q: Array | None = None

    def show(self, *, links: bool, capsules: bool) -> None:
        """Show links, capsules or both."""
        for handle in self._surfaces:
            handle.visible = links
        for handle in self._capsules:
            handle.visible = capsules or not self.has_surfaces
        self._shown = links, capsules or not self.has_surfaces
        self._q = None

    def move(self, arm: Kinematics) -> None:
        """Show a posture.

        What is hidden or has not moved is left alone: each place that is told costs 50 µs here,
        and a message to every visitor.
        """
        if self._q is not None and np.array_equal(self._q, arm.q):
            return
        self._q = np.array(arm.q)
        model, data = self._robot.model, self._data
        links, capsules = self._shown
        if links and self._surfaces:
            pin.forwardKinematics(model, data, arm.q)
            for handle, frame in zip(self._surfaces, self._frames):
                place = pin.updateFramePlacement(model, data, frame)
                handle.position = place.translation
                handle.wxyz = wxyz_of(place.rotation)
        if not capsules:
            return
        middles = 0.5 * (arm.segment_start + arm.segment_end)
        turns = upright_to(arm.segment_end - arm.segment_start)
        for handle, middle, turn in zip(self._capsules, middles, turns):
            handle.position, handle.wxyz = middle, wxyz_of(turn)

    def remove(self) -> None:
        """Take it off the page."""
        for handle in (*self._surfaces, *self._capsules):
            handle.remove()


class ArmView:
    """One arm with all that is shown of its motion."""

    def __init__(
        self, scene: viser.SceneApi, name: str, robot: Robot, surfaces: Sequence[LinkSurface],
    ) -> None:
        """Draw an arm; arguments as of `LinksView`."""
        self._scene, self._name = scene, name
        self.links = LinksView(scene, name, robot, surfaces)
        self._trail: deque[Array] = deque(maxlen=_TRAIL)
        self._path = np.zeros((0, 3))
        self._line: viser.LineSegmentsHandle | None = None
        self._ends = np.zeros((2, 3))
        self._drawn: dict[str, viser.LineSegmentsHandle] = {}

    def show(
        self, arm: Kinematics, near: NearestPair | None, reference: Array,
    ) -> None:
        """Show a posture.

        Args:
            arm: the posture.
            near: the nearest pair, None without one.
            reference: (k, 3) where the tip should have been [m]; drawn if it is another array.
        """
        self.links.move(arm)
        if _extended(self._trail, arm.tip_position):
            self._draw('trail', np.array(self._trail), TRAIL, 3.0)
        if reference is not self._path:
            self._path = reference
            self._draw('reference', reference, REFERENCE, 2.0)
        self._show_pair(near)

    def forget(self) -> None:
        """Begin new trails."""
        self._trail.clear()
        for handle in self._drawn.values():
            handle.remove()
        self._drawn = {}

    def remove(self) -> None:
        """Take it off the page."""
        self.forget()
        self.links.remove()
        self._show_pair(None)

    def _draw(self, what: str, points: Array, color: Color, width: float) -> None:
        if len(points) < 2:
            return
        ends = points.astype(np.float32)
        segments = np.stack((ends[:-1], ends[1:]), axis=1)
        if what in self._drawn:
            self._drawn[what].points = segments
        else:
            self._drawn[what] = self._scene.add_line_segments(
                f'{self._name}/{what}', segments, color, thickness=width,
                thickness_units='screen')

    def _show_pair(self, near: NearestPair | None) -> None:
        if near is None:
            if self._line is not None:
                self._line.remove()
                self._line = None
            return
        if self._line is not None and float(np.abs(near.ends - self._ends).max()) < _SEEN:
            return
        self._ends = near.ends
        colors = np.array([[NEAREST if near.distance > 0.0 else TOUCHING] * 2], dtype=np.uint8)
        ends = near.ends[None].astype(np.float32)
        if self._line is None:
            self._line = self._scene.add_line_segments(
                f'{self._name}/nearest', ends, colors, thickness=4.0,
                thickness_units='screen')
        else:
            self._line.points, self._line.colors = ends, colors


def _extended(points: deque[Array], point: Array) -> bool:
    """Append a point if it is away from the last one; return whether it was."""
    if points and float(np.abs(points[-1] - point).max()) < _STEP:
        return False
    points.append(np.array(point))
    return True


def wxyz_of(rotation: Array) -> Array:
    """Return a rotation matrix (3, 3) as viser's quaternion (4,) w x y z."""
    x, y, z, w = quaternion_of(rotation)
    return np.array((w, x, y, z))


def capsule_surface(
    radius: float, length: float,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
    """Return vertices (k, 3) and triangles (t, 3) of a capsule along z around the origin [m]."""
    rings = [(0.5 * np.pi * i / _RINGS, 0.5 * length) for i in range(_RINGS, -1, -1)]
    rings += [(-0.5 * np.pi * i / _RINGS, -0.5 * length) for i in range(_RINGS + 1)]
    around = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    vertices = [(radius * np.cos(up) * np.cos(turn), radius * np.cos(up) * np.sin(turn),
                 middle + radius * np.sin(up)) for up, middle in rings for turn in around]
    triangles = []
    for ring in range(len(rings) - 1):
        for side in range(_SIDES):
            a, b = ring * _SIDES + side, ring * _SIDES + (side + 1) % _SIDES
            triangles += [(a, a + _SIDES, b), (b, a + _SIDES, b + _SIDES)]
    return np.array(vertices, dtype=np.float32), np.array(triangles, dtype=np.uint32)

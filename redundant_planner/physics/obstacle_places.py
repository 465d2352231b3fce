"""Puts the obstacles of a scene into the model's places for them."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.obstacle import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    HALF_SPACE,
    SHAPES,
)
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.physics.model import ArmModel, FAR_BELOW

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_GEOMS = {ELLIPSOID: mujoco.mjtGeom.mjGEOM_ELLIPSOID, BOX: mujoco.mjtGeom.mjGEOM_BOX,
          CYLINDER: mujoco.mjtGeom.mjGEOM_CYLINDER, CAPSULE: mujoco.mjtGeom.mjGEOM_CAPSULE,
          HALF_SPACE: mujoco.mjtGeom.mjGEOM_BOX}
_GEOM_OF = np.array([int(_GEOMS[shape]) for shape in SHAPES])
_COLOR = (0.86, 0.42, 0.25, 1.0)
# A half-space is a box of this half size [m].
_HALF_SPACE = 50.0
_THINNEST = 1e-6
# Once a link has moved by this, the nearest obstacles are chosen anew [m].
_FAR = 0.02


class ObstaclePlaces:
    """The places for obstacles of one model.

    Attributes:
        names: of the obstacles that are bodies now, place by place.
    """

    def __init__(self, arm: ArmModel) -> None:
        """Begin with all of them empty."""
        self.names: tuple[str, ...] = ()
        self._model, self._geoms, self._base = arm.model, arm.places, arm.base
        self._bodies = arm.model.geom_bodyid[arm.places]
        self._mocaps = arm.model.body_mocapid[self._bodies]
        self._boxes = arm.model.body_bvhadr[self._bodies]
        self._links = np.array(sorted(arm.shapes), dtype=np.intp)
        self._scene: Scene | None = None
        # Where the links were when the nearest obstacles were chosen.
        self._chosen_at = np.full((len(self._links), 3), np.inf)

    def show(self, scene: Scene, data: mujoco.MjData) -> None:
        """Make a scene's obstacles bodies, the nearest ones where they are too many."""
        many = len(scene.names) > len(self._geoms)
        if scene is self._scene and not (many and self._has_moved(data)):
            return
        self._scene = scene
        chosen = self._nearest(scene, data) if many else np.arange(len(scene.names))
        used = len(chosen)
        origin = data.xpos[self._base]
        axes = data.xmat[self._base].reshape(3, 3)
        kinds, half = scene.shapes[chosen], scene.half_extents[chosen]
        turns = axes @ scene.rotations[chosen]
        centers = origin + scene.centers[chosen] @ axes.T
        spaces = kinds == SHAPES.index(HALF_SPACE)
        if spaces.any():
            half = np.where(spaces[:, None], _HALF_SPACE, half)
            centers = centers - np.where(spaces[:, None], _HALF_SPACE * turns[:, :, 2], 0.0)
        self._shape(slice(0, used), kinds, half)
        data.mocap_pos[self._mocaps[:used]] = centers
        quaternion = np.empty(4)
        for mocap, turn in zip(self._mocaps[:used].tolist(), turns):
            mujoco.mju_mat2Quat(quaternion, turn.ravel())
            data.mocap_quat[mocap] = quaternion
        if used < len(self.names):
            self._clear(slice(used, len(self.names)), data)
        self.names = tuple(scene.names[i] for i in chosen.tolist())

    def _has_moved(self, data: mujoco.MjData) -> bool:
        """Return whether a link has moved so far that others may be the nearest obstacles."""
        return bool((np.abs(self._ends(data)[0] - self._chosen_at) > _FAR).any())

    def _ends(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Return where the links' capsules begin, and their axes with their lengths (k, 3)."""
        half = self._model.geom_size[self._links, 1:2] * (
            self._model.geom_type[self._links, None] == mujoco.mjtGeom.mjGEOM_CAPSULE)
        axes = data.geom_xmat[self._links].reshape(-1, 3, 3)[:, :, 2] * half
        return data.geom_xpos[self._links] - axes, 2.0 * axes

    def _nearest(self, scene: Scene, data: mujoco.MjData) -> Indices:
        """Return those, as many as there are places, whose balls are nearest to a link."""
        starts, axes = self._ends(data)
        self._chosen_at = starts
        centers = (data.xpos[self._base]
                   + scene.centers @ data.xmat[self._base].reshape(3, 3).T)
        apart = np.full(len(centers), np.inf)
        for start, axis in zip(starts, axes):
            square = max(float(axis @ axis), _THINNEST**2)
            along = np.clip((centers - start) @ axis / square, 0.0, 1.0)
            apart = np.minimum(
                apart, np.linalg.norm(centers - start - along[:, None] * axis, axis=1))
        apart -= np.linalg.norm(scene.half_extents, axis=1)
        apart[scene.shapes == SHAPES.index(HALF_SPACE)] = -np.inf
        return np.sort(np.argpartition(apart, len(self._geoms))[:len(self._geoms)])

    def _shape(self, places: slice, kinds: Indices, half: Array) -> None:
        """Give geoms their shapes, with all that MuJoCo derives from a shape when it compiles."""
        model, geoms, bodies = self._model, self._geoms[places], self._bodies[places]
        x, z = half[:, 0], half[:, 2]
        sizes = half.copy()
        capsules, cylinders, ellipsoids = (
            kinds == SHAPES.index(shape) for shape in (CAPSULE, CYLINDER, ELLIPSOID))
        sizes[capsules, 1] = np.maximum(z - x, _THINNEST)[capsules]
        sizes[cylinders, 1] = z[cylinders]
        sizes[capsules | cylinders, 2] = 0.0
        model.geom_type[geoms] = _GEOM_OF[kinds]
        model.geom_size[geoms] = sizes
        model.geom_rbound[geoms] = np.select(
            [ellipsoids, capsules, cylinders], [half.max(axis=1, initial=0.0), z, np.hypot(x, z)],
            np.linalg.norm(half, axis=1))
        model.geom_aabb[geoms, 3:] = half
        model.bvh_aabb[self._boxes[places], 3:] = half
        model.geom_conaffinity[geoms] = model.body_conaffinity[bodies] = 1
        model.geom_rgba[geoms] = _COLOR

    def _clear(self, places: slice, data: mujoco.MjData) -> None:
        model = self._model
        model.geom_conaffinity[self._geoms[places]] = 0
        model.body_conaffinity[self._bodies[places]] = 0
        model.geom_rgba[self._geoms[places]] = 0.0
        data.mocap_pos[self._mocaps[places]] = 0.0, 0.0, FAR_BELOW

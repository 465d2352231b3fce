"""MoveIt's planning scene, kept up to date from its messages as MoveIt itself does.

Nothing here needs ROS or moveit_msgs: messages are read by the names of their fields. A scene is
never changed; a message leads to a new one. What a message asks for that cannot be done is a
sentence, and the rest of the message counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ObstacleError, shown
from redundant_planner.io.cdr import LONGEST_NAME
from redundant_planner.perception.octree import occupied
from redundant_planner.perception.scene_contacts import matrix_of
from redundant_planner.perception.scene_records import (
    alike,
    HeldObject,
    PlanningScene,
    same_entries,
    Surroundings,
    Voxels,
    WorldObject,
)
from redundant_planner.perception.scene_shapes import (
    inverse,
    moved,
    pose_of_message,
    pose_of_transform,
    Shapes,
    shapes_of,
)

Array = npt.NDArray[np.float64]

# What MoveIt calls its octomap, which no object may be called.
OCTOMAP = '<octomap>'
# moveit_msgs/CollisionObject's operations.
_ADD, _REMOVE, _APPEND, _MOVE = range(4)
_OPERATIONS = {_ADD: 'ADD', _REMOVE: 'REMOVE', _APPEND: 'APPEND', _MOVE: 'MOVE'}


def with_scene(
    scene: PlanningScene, message: Any, around: Surroundings,
) -> tuple[PlanningScene, list[str]]:
    """Return the scene after a moveit_msgs/PlanningScene, and a sentence per problem.

    One that is no diff replaces all.
    """
    change = _Change(scene, around)
    state, world = message.robot_state, message.world
    whole = not message.is_diff
    if whole or len(message.fixed_frame_transforms):
        change.take_frames(message.fixed_frame_transforms)
    told = bool(len(state.joint_state.name) or len(state.multi_dof_joint_state.joint_names))
    if whole or (told and not state.is_diff):
        change.held.clear()
    for attached in state.attached_collision_objects:
        if state.is_diff or attached.object.operation == _ADD:
            change.take_attached(attached)
        else:
            change.say(attached.object.id, 'is to be changed by a robot_state that is not marked '
                       'as is_diff: only ADD counts there; ignored')
    if whole:
        change.objects.clear()
        change.voxels = None
    if whole or len(message.allowed_collision_matrix.entry_names):
        change.take_matrix(message.allowed_collision_matrix)
    if any(padding.padding for padding in message.link_padding) or any(
            scale.scale != 1.0 for scale in message.link_scale):
        change.problems.append(
            "link_padding and link_scale of the scene are not read: the planner's "
            'clearance.margin is what its links keep')
    for thing in world.collision_objects:
        change.take_object(thing)
    if whole or world.octomap.octomap.id or len(world.octomap.octomap.data):
        change.take_octomap(world.octomap)
    return change.result()


def with_object(
    scene: PlanningScene, message: Any, around: Surroundings,
) -> tuple[PlanningScene, list[str]]:
    """Return the scene after a moveit_msgs/CollisionObject, and a sentence per problem."""
    change = _Change(scene, around)
    change.take_object(message)
    return change.result()


def with_attached(
    scene: PlanningScene, message: Any, around: Surroundings,
) -> tuple[PlanningScene, list[str]]:
    """Return the scene after a moveit_msgs/AttachedCollisionObject, and a sentence per problem."""
    change = _Change(scene, around)
    change.take_attached(message)
    return change.result()


class _Change:
    """A scene that is on its way to the next one."""

    def __init__(self, scene: PlanningScene, around: Surroundings) -> None:
        self._scene, self._around = scene, around
        self.objects, self.held = dict(scene.objects), dict(scene.held)
        self.voxels, self.matrix, self.fixed = scene.voxels, scene.matrix, scene.fixed
        self.problems: list[str] = []

    def result(self) -> tuple[PlanningScene, list[str]]:
        """Return the scene, the one before if it is as it was, and a sentence per problem."""
        before = self._scene
        same = (self.voxels is before.voxels and self.matrix is before.matrix
                and self.fixed is before.fixed and same_entries(self.objects, before.objects)
                and same_entries(self.held, before.held))
        return before if same else replace(
            before, objects=self.objects, held=self.held, voxels=self.voxels,
            matrix=self.matrix, fixed=self.fixed), self.problems

    def say(self, name: str, what: str) -> None:
        """Note a sentence about an object."""
        self.problems.append(f'object {name[:LONGEST_NAME]!r} {what}')

    def take_frames(self, transforms: Sequence[Any]) -> None:
        """Take the frames that the scene says itself for all that there are."""
        fixed = {}
        for transform in transforms:
            name, parent = transform.child_frame_id, transform.header.frame_id
            try:
                if name.lstrip('/') != parent.lstrip('/'):
                    fixed[name.lstrip('/')] = parent, pose_of_transform(transform.transform)
            except ObstacleError as error:
                self.problems.append(f'frame {name!r} of fixed_frame_transforms {error}; ignored')
        self.fixed = fixed

    def take_matrix(self, message: Any) -> None:
        """Take another allowed collision matrix."""
        try:
            self.matrix = matrix_of(message)
        except ObstacleError as error:
            self.problems.append(f'allowed_collision_matrix {error}; ignored')

    def take_octomap(self, message: Any) -> None:
        """Take another octomap, or none; one that is of no use leaves the last one."""
        if not len(message.octomap.data):
            self.voxels = None
            return
        try:
            pose = self._frame(message.header.frame_id) @ pose_of_message(message.origin)
            center = (inverse(pose) @ np.append(self._around.center, 1.0))[:3]
            self.voxels = Voxels(
                pose, occupied(message.octomap, center, self._around.radius))
        except ObstacleError as error:
            self.problems.append(f'octomap ignored: {error}')

    def take_object(self, message: Any) -> None:
        """Take an object of the world."""
        try:
            _check_name(message.id)
            operation = _operation(message)
            if operation in (_ADD, _APPEND):
                self._add(message)
            elif operation == _MOVE:
                self._move(message)
            elif not message.id:
                self.objects.clear()
            elif self.objects.pop(message.id, None) is None and message.id not in self.held:
                raise ObstacleError('is to be removed, and the scene has no such object')
        except ObstacleError as error:
            self.say(message.id, f'{error}; ignored')

    def take_attached(self, message: Any, *, only_add: bool = False) -> None:
        """Take an object into the hand, or out of it, or only into it."""
        thing = message.object
        try:
            _check_name(thing.id)
            operation = _operation(thing)
            if only_add and operation != _ADD:
                raise ObstacleError('is to be changed by a robot_state that is not marked as '
                                    'is_diff: only ADD counts there')
            if operation in (_ADD, _APPEND):
                self._attach(message)
            elif operation == _REMOVE:
                self._detach(message)
            else:
                raise ObstacleError('is to be moved while it is attached: there is no such MOVE')
        except ObstacleError as error:
            self.say(thing.id, f'{error}; ignored')

    def _shapes(self, message: Any) -> Shapes:
        shapes = shapes_of(message)
        for remark in shapes.remarks:
            self.problems.append(f'object {message.id!r}, {remark}')
        if len(message.subframe_names):
            self.say(message.id, 'has subframes: they are not read')
        if not shapes.solids:
            raise ObstacleError('has no shape that can be used')
        return shapes

    def _add(self, message: Any) -> None:
        there = self.objects.get(message.id) if _operation(message) == _APPEND else None
        frame = self._frame(message.header.frame_id)
        shapes = self._shapes(message)
        if there is not None:
            # The object stays where it is; the new shapes are relative to it.
            self.objects[message.id] = there._replace(solids=there.solids + shapes.solids)
        else:
            self.objects[message.id] = WorldObject(frame @ shapes.pose, shapes.solids)

    def _move(self, message: Any) -> None:
        there = self.objects.get(message.id)
        if there is None:
            raise ObstacleError('is to be moved, and the scene has no such object')
        if len(message.primitives) or len(message.meshes) or len(message.planes):
            self.say(message.id, 'has shapes in a MOVE: they do not count')
        pose = self._frame(message.header.frame_id) @ pose_of_message(message.pose)
        self.objects[message.id] = there._replace(pose=pose)
        poses = [*message.primitive_poses, *message.mesh_poses, *message.plane_poses]
        if poses:
            self.objects[message.id] = WorldObject(pose, moved(there.solids, poses))

    def _attach(self, message: Any) -> None:
        thing, link, touch = message.object, message.link_name, tuple(message.touch_links)
        there = self.objects.get(thing.id)
        held = self.held.get(thing.id)
        empty = not (len(thing.primitives) or len(thing.meshes) or len(thing.planes))
        if empty and _operation(thing) == _ADD:
            if there is None:
                if held is not None and held.link == link:
                    return
                raise ObstacleError(f'is to be attached to {link!r} without a shape, and the '
                                    'scene has no such object')
            made = HeldObject(link, inverse(self._frame(link)) @ there.pose, there.solids, touch)
        else:
            shapes = self._shapes(thing)
            frame = np.eye(4)
            if thing.header.frame_id.lstrip('/') != link:
                frame = inverse(self._frame(link)) @ self._frame(thing.header.frame_id)
            made = HeldObject(link, frame @ shapes.pose, shapes.solids, touch)
            if _operation(thing) == _APPEND and held is not None:
                own = held.link == link and np.array_equal(shapes.pose, np.eye(4))
                made = HeldObject(
                    link, held.pose if own else made.pose, made.solids + held.solids,
                    tuple(dict.fromkeys(held.touch_links + touch)))
        self.objects.pop(thing.id, None)
        # move_group lists all that is attached with each state.
        self.held[thing.id] = held if held is not None and alike(held, made) else made

    def _detach(self, message: Any) -> None:
        name, link = message.object.id, message.link_name
        if name:
            held = self.held.get(name)
            if held is None:
                raise ObstacleError('is to be detached, and no such object is attached')
            if link and held.link != link:
                raise ObstacleError(f'is to be detached from {link!r}, and it is attached to '
                                    f'{held.link!r}')
        for one, held in list(self.held.items()):
            if one == name or (not name and link in ('', held.link)):
                if one in self.objects:
                    self.say(one, 'is detached, and the world has an object of that name: that '
                             'one stays')
                else:
                    self.objects[one] = WorldObject(
                        self._frame(held.link) @ held.pose, held.solids)
                del self.held[one]

    def _frame(self, name: str) -> Array:
        """Return the pose (4, 4) of a frame in the base frame.

        Raises:
            ObstacleError: nobody knows it.
        """
        name = name.lstrip('/')
        seen = []
        pose = np.eye(4)
        while True:
            if name in self.objects:
                return self.objects[name].pose @ pose
            if name in self.held:
                held = self.held[name]
                name, pose = held.link, held.pose @ pose
            if name not in self.fixed or name in seen:
                break
            seen.append(name)
            parent, step = self.fixed[name]
            name, pose = parent.lstrip('/'), step @ pose
        try:
            return self._around.frame(name) @ pose
        except ObstacleError as error:
            thing = name.partition('/')[0]
            if thing in self.objects or thing in self.held:
                raise ObstacleError(f'is given in {name!r}, a subframe of {thing!r}: subframes '
                                    'are not read') from None
            raise ObstacleError(f'is given in frame {name!r}: {error}') from None


def _check_name(name: str) -> None:
    """Make sure that something may be called so.

    Raises:
        ObstacleError: it is MoveIt's name of the octomap, or no marker's.
    """
    if name == OCTOMAP:
        raise ObstacleError('has the name of the octomap, which no object may have')
    try:
        size = len(name.encode())
    except UnicodeEncodeError:
        raise ObstacleError('has a name that is no Unicode text') from None
    if size > LONGEST_NAME - 1 or '\0' in name:
        raise ObstacleError(f'has a name of {size} bytes; it takes up to {LONGEST_NAME - 1}, none '
                            'of them zero')


def _operation(message: Any) -> int:
    """Return what a CollisionObject is to do.

    Raises:
        ObstacleError: it is none of the operations.
    """
    given = message.operation
    # rclpy gives a ROS byte as bytes.
    number = int.from_bytes(given, 'little') if isinstance(given, bytes) else given
    if number not in _OPERATIONS:
        listed = ', '.join(f'{name} ({number})' for number, name in _OPERATIONS.items())
        raise ObstacleError(f'has the operation {shown(number)}; it must be {listed}')
    return int(number)

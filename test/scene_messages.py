"""Messages of MoveIt's planning scene by their fields alone: moveit_msgs is not on PyPI."""

from __future__ import annotations

from types import SimpleNamespace as Message

ADD, REMOVE, APPEND, MOVE = range(4)
BOX, SPHERE, CYLINDER, CONE, PRISM = range(1, 6)


def point(x=0.0, y=0.0, z=0.0):
    return Message(x=x, y=y, z=z)


def pose(position=(0.0, 0.0, 0.0), quaternion=(0.0, 0.0, 0.0, 1.0)):
    x, y, z, w = quaternion
    return Message(position=point(*position), orientation=Message(x=x, y=y, z=z, w=w))


def primitive(kind, *dimensions, corners=()):
    return Message(type=kind, dimensions=list(dimensions), polygon=Message(
        points=[point(*corner) for corner in corners]))


def mesh(vertices):
    return Message(vertices=[point(*vertex) for vertex in vertices], triangles=[])


def plane(*coefficients):
    return Message(coef=list(coefficients))


def thing(name, operation=ADD, at=None, frame='', **shapes):
    """A CollisionObject; shapes are its lists, such as primitives and primitive_poses."""
    fields = {'primitives': [], 'primitive_poses': [], 'meshes': [], 'mesh_poses': [],
              'planes': [], 'plane_poses': [], 'subframe_names': [], 'subframe_poses': []}
    return Message(id=name, operation=bytes([operation]), pose=at or pose(),
                   header=Message(frame_id=frame), **{**fields, **shapes})


def attached(link, what, touch_links=()):
    """An AttachedCollisionObject."""
    return Message(link_name=link, object=what, touch_links=list(touch_links))


def matrix(names=(), pairs=(), defaults=()):
    """An AllowedCollisionMatrix in which pairs of names may touch."""
    names = list(names)
    allowed = [[(a, b) in pairs or (b, a) in pairs for b in names] for a in names]
    return Message(
        entry_names=names, entry_values=[Message(enabled=row) for row in allowed],
        default_entry_names=[name for name, _ in defaults],
        default_entry_values=[value for _, value in defaults])


def octomap(data=b'', resolution=0.05, binary=True, name='OcTree', origin=None, frame=''):
    """An OctomapWithPose."""
    return Message(header=Message(frame_id=frame), origin=origin or pose(), octomap=Message(
        id=name, resolution=resolution, binary=binary, data=data))


def scene(objects=(), held=(), is_diff=True, state_is_diff=True, joints=(), contacts=None,
          voxels=None, frames=()):
    """A PlanningScene."""
    return Message(
        name='', is_diff=is_diff, fixed_frame_transforms=list(frames), link_padding=[],
        link_scale=[], allowed_collision_matrix=contacts or matrix(),
        robot_state=Message(
            is_diff=state_is_diff, joint_state=Message(name=list(joints)),
            multi_dof_joint_state=Message(joint_names=[]),
            attached_collision_objects=list(held)),
        world=Message(collision_objects=list(objects), octomap=voxels or octomap(name='')))

"""An arm's chain, its capsules and obstacles as MuJoCo's XML."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from benchmark.peers.arm import in_joint
from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, ELLIPSOID, Obstacle
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# A shape in MuJoCo's words; a capsule whose segment is shorter is a sphere [m].
_GEOMS = {ELLIPSOID: 'ellipsoid', BOX: 'box', CYLINDER: 'cylinder', CAPSULE: 'capsule'}
_LEAST_LENGTH = 1e-6
_INERTIA = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
_AXES = {'x': '1 0 0', 'y': '0 1 0', 'z': '0 0 1'}


def mjcf(
    robot: Robot, obstacles: Sequence[Obstacle], thinner: float | None = None,
    thicker: float = 0.0,
) -> str:
    """Return the arm's joints, its capsules and the obstacles as a MuJoCo model.

    Args:
        robot: the arm.
        obstacles: that can be moved, as mocap bodies.
        thinner: if given, every shape has a body of its name to itself, those of obstacles on
            three slides and three hinges in place of mocap; and the capsules are there once more,
            as own0 and on, with radii less by so much [m].
        thicker: by how much all capsules are [m].
    """
    model = robot.model
    shapes: dict[int, list[str]] = {}
    for i, capsule in enumerate(robot.capsules):
        joint, start, end = in_joint(robot, capsule)
        names = {f'link{i}': capsule.radius + thicker}
        if thinner is not None:
            names[f'own{i}'] = capsule.radius + thicker - thinner
        for name, radius in names.items():
            geom = _capsule(name, start, end, max(radius, 1e-5))
            shapes.setdefault(joint, []).append(
                geom if thinner is None else f'<body name="{name}">{geom}</body>')
    for t, frame in enumerate(robot.tips):
        tip = model.frames[model.getFrameId(frame)]
        shapes.setdefault(int(tip.parentJoint), []).append(
            f'<site name="tip{t}" {_placed(tip.placement)}/>')
    carried = [''.join(shapes.get(i, [])) for i in range(robot.n + 1)]
    for i in range(robot.n, 0, -1):  # what a joint carries comes after it
        placement, joint = model.jointPlacements[i], model.joints[i]
        subspace = np.array(joint.createData().S).reshape(6)
        turning = bool(np.any(subspace[3:]))
        low, high = robot.position_min[i - 1], robot.position_max[i - 1]
        limited = np.isfinite(low) and np.isfinite(high)
        reach = f'limited="true" range="{low} {high}"' if limited else 'limited="false"'
        # MuJoCo takes joints in the order of its file: the later of two siblings comes last.
        carried[model.parents[i]] = (
            f'<body {_placed(placement)}>{_INERTIA}'
            f'<joint name="{robot.joint_names[i - 1]}" type="{"hinge" if turning else "slide"}" '
            f'axis="{_text(subspace[3:] if turning else subspace[:3])}" {reach}/>'
            f'{carried[i]}</body>{carried[model.parents[i]]}')
    body = carried[0]
    for i, obstacle in enumerate(obstacles):
        at = pin.SE3(obstacle.rotation, obstacle.center)
        geom = _geom(f'obstacle{i}', obstacle)
        body += (f'<body mocap="true" {_placed(at)}>{geom}</body>' if thinner is None
                 else _six_joints(i, geom))
    if thinner is not None:
        body = f'<body name="base">{_INERTIA}{body}</body>'
    return ('<mujoco><compiler angle="radian"/>'
            f'<worldbody>{body}</worldbody></mujoco>')


def _six_joints(i: int, geom: str) -> str:
    """Return a body that three slides and three hinges about x, y and z place, in this order."""
    opened = ''.join(
        f'<body name="{kind}{axis}_of_{i}">{_INERTIA}<joint name="{kind}_{axis}{i}" '
        f'type="{kind}" axis="{along}" limited="true" range="-100 100"/>'
        for kind in ('slide', 'hinge') for axis, along in _AXES.items())
    return f'{opened}<body name="obstacle{i}">{geom}</body>' + 6 * '</body>'


def _capsule(name: str, start: Array, end: Array, radius: float) -> str:
    """Return a capsule as MuJoCo's geom; its ends in the joint's frame [m]."""
    if _distance(start, end) < _LEAST_LENGTH:
        return f'<geom name="{name}" type="sphere" size="{radius}" pos="{_text(start)}"/>'
    return (f'<geom name="{name}" type="capsule" size="{radius}" '
            f'fromto="{_text(start)} {_text(end)}"/>')


def _geom(name: str, obstacle: Obstacle) -> str:
    """Return an obstacle as MuJoCo's geom of the same shape; its sizes are halves, too."""
    kind = _GEOMS[obstacle.shape]
    x, y, z = obstacle.half_extents.tolist()
    if obstacle.shape == CAPSULE and z - x < _LEAST_LENGTH:
        kind = 'sphere'
    sizes = {'sphere': (x,), 'cylinder': (x, z), 'capsule': (x, z - x)}.get(kind, (x, y, z))
    return f'<geom name="{name}" type="{kind}" size="{_text(np.array(sizes))}"/>'


def _distance(a: Array, b: Array) -> float:
    return float(np.linalg.norm(b - a))


def _text(values: Array) -> str:
    return ' '.join(repr(float(value)) for value in values)


def _placed(placement: pin.SE3) -> str:
    x, y, z, w = pin.Quaternion(placement.rotation).coeffs()
    return f'pos="{_text(placement.translation)}" quat="{_text(np.array([w, x, y, z]))}"'

"""The arm as MuJoCo's model, with places for obstacles in it.

Bodies, joints, inertias and torque limits are the URDF's; the shapes that collide are the capsules
that the planner keeps clear. Places for obstacles are bodies that belong to no joint, each with
one shape that may change at any time: nothing is compiled anew while the arm moves, and whoever
looks at the model (a viewer, a film) keeps looking at the same one.
"""

from __future__ import annotations

from dataclasses import dataclass
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, RobotError
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.simulated_arm import joint_ranges, JointRanges
from redundant_planner.core.robot.urdf import Joint, MOVABLE, numbers, read_urdf, Urdf
from redundant_planner.io.physics_parameters import PhysicsParameters
from redundant_planner.physics import PhysicsError
from redundant_planner.physics.inertia import (
    ball,
    bodies_without_inertia,
    DENSITY,
    Inertia,
    inertias,
    remarks_on,
    rotation_of,
)

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

# Obstacles that are bodies at a time, the nearest ones. Each costs 0.15 µs in every step.
PLACES = 128
# Where those that are not in use lie [m].
FAR_BELOW = -1000.0
# Bare lines get this radius, as every body has some [m].
_THINNEST = 1e-3
# Postures among which the largest inertia about each joint is looked for.
_SAMPLED_POSTURES = 64
# How fast a joint that mimics another one is drawn to its place [s].
_MIMIC_TIME = 0.005
_ARM_COLOR = (0.85, 0.86, 0.88, 1.0)
_SKY, _HORIZON, _FLOOR = (0.55, 0.67, 0.8), (0.93, 0.95, 0.97), (0.8, 0.82, 0.84, 0.4)


@dataclass(frozen=True)
class ArmModel:
    """An arm as MuJoCo has it; n independent joints, in the order of the URDF.

    Attributes:
        model: what is simulated.
        nominal: the same arm as the servo believes it to be, without obstacles.
        ranges: of the joints.
        effort_max: (n,) torque limits [Nm, N], infinite where the URDF gives none.
        stiffness, damping: (n,) of the servo [Nm/rad, Nm s/rad; N/m, N s/m].
        positions, velocities: (n,) where the joints are in qpos and qvel.
        followers: joints that mimic others: place in qpos, the leader's, multiplier, offset.
        base: body of the base frame, which obstacles refer to.
        shapes: number of a geom → name of its capsule.
        places: geoms of the places for obstacles.
        remarks: sentences about what was assumed.
    """

    model: mujoco.MjModel
    nominal: mujoco.MjModel
    ranges: JointRanges
    effort_max: Array
    stiffness: Array
    damping: Array
    positions: Indices
    velocities: Indices
    followers: tuple[tuple[int, int, float, float], ...]
    base: int
    shapes: dict[int, str]
    places: Indices
    remarks: tuple[str, ...]


def arm_model(robot: Robot, parameters: PhysicsParameters) -> ArmModel:
    """Return the model of an arm.

    Raises:
        RobotError: the URDF cannot be simulated, with the reason.
        PhysicsError: MuJoCo refuses the model.
    """
    urdf, ranges = read_urdf(robot.urdf), joint_ranges(robot.urdf)
    given, balls = inertias(urdf)
    assumed = bodies_without_inertia(urdf, given)
    remarks = remarks_on(assumed, balls)
    limits = efforts(robot.urdf)
    effort_max = np.array([limits[name] or np.inf for name in ranges.names])
    unlimited = [name for name in ranges.names if not limits[name]]
    if unlimited:
        remarks.append(f'the URDF gives no effort limit of {known(unlimited)}: their torque is '
                       'unlimited')
    spec = _spec(robot, urdf, given, assumed, parameters)
    nominal = _compiled(spec)
    _add_places(spec)
    model = _compiled(spec)

    joints = [model.joint(name).id for name in ranges.names]
    velocities = np.array(model.jnt_dofadr[joints], dtype=np.intp)
    inertia = largest_inertias(nominal, ranges)[velocities]
    pace = 2.0 * np.pi * parameters.servo_bandwidth
    stiffness, damping = pace**2 * inertia, 2.0 * pace * inertia
    if parameters.servo == 'off':
        stiffness, damping = np.zeros_like(inertia), np.zeros_like(inertia)
    model.actuator_biasprm[:, 1], model.actuator_biasprm[:, 2] = -stiffness, -damping
    model.actuator_forcelimited[:] = np.isfinite(effort_max)
    model.actuator_forcerange[:] = np.where(
        np.isfinite(effort_max), effort_max, 0.0)[:, None] * (-1.0, 1.0)

    share = 1.0 + parameters.mass_error
    model.body_mass[:] *= share
    model.body_inertia[:] *= share
    mujoco.mj_setConst(model, mujoco.MjData(model))
    # Of the arm, for cameras: the places for obstacles lie far away.
    model.stat.center, model.stat.extent = nominal.stat.center, nominal.stat.extent
    return ArmModel(
        model, nominal, ranges, effort_max, stiffness, damping,
        np.array(model.jnt_qposadr[joints], dtype=np.intp), velocities,
        tuple((int(model.joint(joint.name).qposadr[0]),
               int(model.joint(joint.mimic.leader).qposadr[0]), joint.mimic.multiplier,
               joint.mimic.offset) for joint in urdf.joints
              if joint.kind in MOVABLE and joint.mimic is not None),
        model.body(_body_name(robot.base_frame)).id,
        {model.geom(_shape_name(i)).id: capsule.name for i, capsule in enumerate(robot.capsules)},
        np.array([model.geom(f'place {i}').id for i in range(PLACES)], dtype=np.intp),
        tuple(remarks))


def efforts(urdf: str) -> dict[str, float]:
    """Return the effort limit of each movable joint [Nm, N], 0 where the URDF has none.

    Raises:
        RobotError: a limit is not a positive number.
    """
    found = {}
    for element in ElementTree.fromstring(urdf).findall('joint'):
        name = element.get('name', '')
        if element.get('type') in MOVABLE:
            what = f"the limit of joint '{name}' of the URDF"
            (effort,) = numbers(element.find('limit'), 'effort', what, default=(0.0,),
                                largest=np.inf)
            if not 0.0 <= effort < np.inf:
                raise RobotError(f'{what} has effort={effort}; it takes a positive number')
            found[name] = effort
    return found


def largest_inertias(model: mujoco.MjModel, ranges: JointRanges) -> Array:
    """Return the largest inertia about each joint at random postures (nv,) [kg m², kg]."""
    data = mujoco.MjData(model)
    matrix, largest = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
    random = np.random.default_rng(0)
    low = np.where(np.isfinite(ranges.position_min), ranges.position_min, -np.pi)
    high = np.where(np.isfinite(ranges.position_max), ranges.position_max, np.pi)
    places = [int(model.joint(name).qposadr[0]) for name in ranges.names]
    for _ in range(_SAMPLED_POSTURES):
        data.qpos[places] = random.uniform(low, high)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix)
        largest = np.maximum(largest, np.diag(matrix))
    return largest


def _spec(
    robot: Robot, urdf: Urdf, given: dict[str, Inertia], assumed: list[str],
    parameters: PhysicsParameters,
) -> mujoco.MjSpec:
    """Return the description of the arm alone."""
    spec = mujoco.MjSpec()
    spec.modelname = urdf.name
    spec.compiler.degree = False
    spec.option.timestep = 1.0 / parameters.physics_rate
    # It takes the damping of servo and joints as it will be at the end of the step: a stiff servo
    # stays stable.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = parameters.gravity
    # Principal moments that break A + B ≥ C, as those of many URDFs do, are evened out.
    spec.compiler.balanceinertia = True
    _decorate(spec)
    bodies = {urdf.root: spec.worldbody.add_body(name=_body_name(urdf.root))}
    below: dict[str, list[Joint]] = {}
    for joint in urdf.joints:
        below.setdefault(joint.parent, []).append(joint)
    order = [urdf.root]
    for link in order:  # grows meanwhile
        for joint in below.get(link, ()):
            bodies[joint.child] = _add_link(bodies[link], joint, parameters)
            order.append(joint.child)

    frames = {joint.name: joint.child for joint in urdf.joints} | {link: link for link in bodies}
    clad = set()
    for i, capsule in enumerate(robot.capsules):
        link = frames[capsule.frame]
        clad.add(link)
        _add_capsule(bodies[link], i, capsule.start, capsule.end, capsule.radius,
                     DENSITY if link in assumed else 0.0)
    for first, second in robot.self_pairs.tolist():
        spec.add_pair(geomname1=_shape_name(first), geomname2=_shape_name(second))
    for link, body in bodies.items():
        inertia = given.get(link) or (ball() if link in assumed and link not in clad else None)
        if inertia is not None:
            m = inertia.matrix
            body.explicitinertial, body.mass, body.ipos = True, inertia.mass, inertia.center
            body.fullinertia = [m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2]]
    for joint in urdf.joints:
        if joint.kind in MOVABLE and joint.mimic is None:
            _add_servo(spec, joint.name)
    _add_mimics(spec, urdf)
    return spec


def _decorate(spec: mujoco.MjSpec) -> None:
    """Add light, sky and a floor that nothing touches, for those who look at it."""
    spec.worldbody.add_light(
        pos=(1.0, -1.5, 3.0), dir=(-0.3, 0.45, -0.9), type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        castshadow=False)
    spec.add_texture(
        name='sky', type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, rgb1=_SKY, rgb2=_HORIZON,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, width=64, height=384)
    spec.worldbody.add_geom(
        name='floor', type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1.2, 1.2, 0.1), rgba=_FLOOR,
        contype=0, conaffinity=0)


def _add_link(
    parent: mujoco.MjsBody, joint: Joint, parameters: PhysicsParameters,
) -> mujoco.MjsBody:
    """Add a link with the joint that it hangs from."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rotation_of(joint.rpy).ravel())
    body = parent.add_body(name=_body_name(joint.child), pos=joint.xyz, quat=quaternion)
    if joint.kind not in MOVABLE:
        return body
    limited = joint.kind != 'continuous'
    body.add_joint(
        name=joint.name, axis=np.array(joint.axis) / np.linalg.norm(joint.axis),
        type=(mujoco.mjtJoint.mjJNT_SLIDE if joint.kind == 'prismatic'
              else mujoco.mjtJoint.mjJNT_HINGE),
        limited=limited, range=(joint.lower, joint.upper) if limited else (0.0, 0.0),
        armature=parameters.armature, damping=parameters.joint_damping)
    return body


def _add_servo(spec: mujoco.MjSpec, joint: str) -> None:
    """Add a drive: torque = control − stiffness · position − damping · velocity, within limits."""
    spec.add_actuator(
        name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED, gainprm=[1.0, *[0.0] * 9],
        biastype=mujoco.mjtBias.mjBIAS_AFFINE, biasprm=[0.0] * 10,
        forcelimited=True, forcerange=(-1.0, 1.0))


def _add_capsule(
    body: mujoco.MjsBody, number: int, start: Array, end: Array, radius: float, density: float,
) -> None:
    """Add a capsule, which meets obstacles and the links of its pairs only."""
    radius = max(radius, _THINNEST)
    common = {'name': _shape_name(number), 'density': density, 'contype': 1, 'conaffinity': 0,
              'rgba': _ARM_COLOR}
    if np.linalg.norm(end - start) < 1e-9:
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=start, size=(radius, 0.0, 0.0),
                      **common)
    else:
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*start, *end],
                      size=(radius, 0.0, 0.0), **common)


def _add_mimics(spec: mujoco.MjSpec, urdf: Urdf) -> None:
    """Couple the joints that mimic others to them."""
    movable = {joint.name for joint in urdf.joints if joint.kind in MOVABLE}
    for joint in urdf.joints:
        if joint.kind not in MOVABLE or joint.mimic is None:
            continue
        if joint.mimic.leader not in movable:
            raise RobotError(f"joint '{joint.name}' of the URDF mimics '{joint.mimic.leader}', "
                             'which does not move')
        equality = spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT, name=f'mimic {joint.name}', name1=joint.name,
            name2=joint.mimic.leader, solref=(_MIMIC_TIME, 1.0))
        equality.data[:2] = joint.mimic.offset, joint.mimic.multiplier


def _add_places(spec: mujoco.MjSpec) -> None:
    """Add bodies for obstacles, which touch nothing until they are used."""
    for i in range(PLACES):
        body = spec.worldbody.add_body(
            name=f'place {i}', mocap=True, pos=(0.0, 0.0, FAR_BELOW))
        body.add_geom(name=f'place {i}', type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
                      size=(0.01, 0.01, 0.01), contype=0, conaffinity=0,
                      rgba=(0.0, 0.0, 0.0, 0.0))


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()
    except ValueError as error:
        raise PhysicsError(f'MuJoCo cannot simulate this URDF: {error}') from None


def _body_name(link: str) -> str:
    return f'link {link}'  # MuJoCo has a body called world, as many URDFs do


def _shape_name(number: int) -> str:
    return f'capsule {number}'

"""Parameters of robots and nodes act in the direction that their descriptions say.

Those of the mathematics are in core/test_parameter_effects.py. Each case takes the part of a node
that the parameter acts on, without ROS, once with a low and once with a high value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

from camera_views import arm_of, body, looking, seen, still, together
from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from geometry_msgs.msg import Twist
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from scene_messages import octomap
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.workspace import walls
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.robot.simulated_arm import joint_ranges, SimulatedArm
from redundant_planner.core.safety.following import Following
from redundant_planner.io.node_parameters import FakeHardwareParameters, PlannerNodeParameters
from redundant_planner.io.obstacle_tracker import ObstacleTracker
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.perception_parameters import (
    CameraParameters,
    CloudParameters,
    SceneParameters,
)
from redundant_planner.io.physics_parameters import PhysicsParameters
from redundant_planner.io.robot_files import Robot
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.supervisor import LISTENING, Supervisor
from redundant_planner.perception.cloud_filter import CloudFilter
from redundant_planner.perception.depth_camera import DepthCamera
from redundant_planner.perception.octree import occupied
from redundant_planner.perception.own_shape import reach_of
from redundant_planner.physics.arm import PhysicsArm
from redundant_planner.simulation import simulate

DT = 0.004
PAPER_START = (0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0)
PANDA = make_panda()

# The two values of a quantity differ by at least this share of the larger one.
LEAST_SHARE = 0.05


@dataclass(frozen=True)
class Case:
    """With `high` instead of `low` a quantity grows (`+`) or shrinks (`-`)."""

    settings: type
    name: str
    low: object
    high: object
    quantity: Callable[..., float]
    sign: str
    others: tuple[tuple[str, object], ...] = ()


def paper_arm(p: RobotParameters):
    return Robot.from_file(ROBOTS / 'paper_2p5r.yaml', **{
        'jerk_max': p.jerk_max, 'acceleration_max': p.acceleration_max,
        'velocity_max': p.velocity_max, 'link_radius': p.link_radius,
        'position_limits': p.position_limits})


def way_in_half_a_second(p: RobotParameters):
    """Of the paper arm's tip, which is told to go faster than its joints can at first [m]."""
    arm = paper_arm(p)
    motion = simulate(Planner(arm, PlannerParameters()), PAPER_START, [0.0, 0.6, -0.3, 0, 0, 0],
                      Scene.of(), 0.5, DT)
    first, last = (arm.kinematics(motion.positions[at]).tip_position for at in (0, -1))
    return np.linalg.norm(last - first)


def time_to_a_target(p: RobotParameters):
    """Of the paper arm's tip, 0.2 m away [s]."""
    arm = paper_arm(p)
    planner, q = Planner(arm, PlannerParameters()), np.array(PAPER_START)
    here = arm.kinematics(q)
    target = Pose(here.tip_position + (0.0, 0.2, 0.0), here.tip_rotation)
    for tick in range(1, 1500):
        result = planner.step(q, np.zeros(6), Scene.of(), DT, target=target)
        q = q + DT * result.dq
        if result.progress.state.value == 'reached':
            return tick * DT
    raise AssertionError('the arm does not arrive')


def clearance_at_rest(p: RobotParameters):
    """Between the paper arm and a ball beside it [m]."""
    ball = Obstacle('ball', [0.0, 0.55, 0.45], [0.05, 0.05, 0.05])
    return simulate(Planner(paper_arm(p), PlannerParameters()), PAPER_START, np.zeros(6),
                    Scene.of([ball]), DT, DT).clearance[0]


def panda_of(p: RobotParameters):
    return Robot.from_file(ROBOTS / 'panda.yaml', urdf=str(PANDA_URDF), acceleration_max=(5.0,),
                           jerk_max=(), **{
        name: getattr(p, name) for name in (
            'axes', 'command_frame', 'locked_joints', 'mount_frame', 'mount_pose')})


def least_norm_speed(p: RobotParameters):
    """The least joint speed that moves the Panda's tip at 0.1 m/s [rad/s]."""
    planner = Planner(panda_of(p), PlannerParameters(horizon_look_ahead=0.0))
    return np.linalg.norm(planner.step(
        PANDA_READY, np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0]), Scene.of(), DT).least_norm)


def rise_of_the_tip(p: RobotParameters):
    """Of the Panda's hand, which points down, with a command along z, after 0.5 s [m]."""
    arm = panda_of(p)
    motion = simulate(Planner(arm, PlannerParameters()), PANDA_READY, [0.0, 0.0, 0.1, 0, 0, 0],
                      Scene.of(), 0.5, DT)
    first, last = (arm.kinematics(motion.positions[at]).tip_position[2] for at in (0, -1))
    return last - first


def way_of_the_base(p: RobotParameters):
    """Of a Panda's base in half a second, with a command for the tip [m]."""
    arm = Robot.from_file(ROBOTS / 'panda.yaml', urdf=str(PANDA_URDF), **{
        name: getattr(p, name) for name in (
            'base', 'base_weight', 'base_speed', 'base_acceleration', 'base_room')})
    start = np.concatenate((np.zeros(3), PANDA_READY))
    motion = simulate(Planner(arm, PlannerParameters()), start, [0.5, 0.5, 0.0, 0, 0, 0],
                      Scene.of(), 1.0, DT)
    return np.linalg.norm(motion.positions[-1][:2])


def number_of_joints(p: RobotParameters):
    return panda_of(p).n


def height_of_the_tip(p: RobotParameters):
    """In the frame that commands and obstacles are given in [m]."""
    return panda_of(p).kinematics(PANDA_READY).tip_position[2]


def time_that_a_twist_counts(p: PlannerNodeParameters):
    """After it came [s]."""
    now = 100.0
    command = CommandInput({'base': 'base'}, 'base', lambda: now, lambda: now, print)
    message = Twist()
    message.linear.x = 0.1
    command.on_twist(bytes(serialize_message(message)))
    while command.moves(p.incoming_command_timeout):
        now += 1e-3
    return now - 100.0


def time_that_a_measurement_counts(p: PlannerNodeParameters):
    """Until a moving arm is stopped because joint_states are missing [s]."""
    supervisor, now = Supervisor(np.ones(2), 0.1), 0.0
    while now < 2.0 * LISTENING:
        now += DT
        supervisor.measured(np.zeros(2), now)
        supervisor.decide(now, False, p.joint_state_timeout)
    last = now
    while not supervisor.decide(now, False, p.joint_state_timeout).hold:
        now += 1e-3
    return now - last


def believed_speed(p: PlannerNodeParameters):
    """Of an obstacle that was seen at two places [m/s]."""
    tracker = ObstacleTracker([], ['base'], estimate_velocity=p.estimate_obstacle_velocity)
    for now in (0.0, 0.1):
        made = Marker(ns='o', type=Marker.SPHERE)
        made.header.frame_id = 'base'
        made.pose.position.x, made.pose.orientation.w = 0.1 * now, 1.0
        made.scale.x = made.scale.y = made.scale.z = 0.1
        tracker.update(bytes(serialize_message(MarkerArray(markers=[made]))), now)
    return np.linalg.norm(tracker.scene.velocities)


def way_up(p: PlannerNodeParameters):
    """Of the Panda's tip in 2 s, commanded at 0.1 m/s [m]."""
    motion = simulate(Planner(PANDA, PlannerParameters()), PANDA_READY,
                      [0.0, 0.0, 0.1, 0.0, 0.0, 0.0], Scene.of(walls(p.workspace)), 2.0, DT)
    first, last = (PANDA.kinematics(motion.positions[at]).tip_position[2] for at in (0, -1))
    return last - first


def way_after_the_last_command(p: FakeHardwareParameters):
    """Of the first joint, which was told to move at 0.1 m/s or 0.5 rad/s."""
    ranges = joint_ranges(PANDA_URDF.read_text())
    arm = SimulatedArm(ranges, {'panda_joint4': -1.0}, command_timeout=p.command_timeout)
    arm.command(0.0, np.array([0.5, *[0.0] * (len(ranges.names) - 1)]))
    arm.advance(1.0)
    return arm.q[0]


def heavy_arm(p: PhysicsParameters):
    return PhysicsArm(PANDA, p, dict(zip(PANDA.joint_names, PANDA_READY)))


def sag(p: PhysicsParameters):
    """Of the fourth joint after 0.15 s without a command [rad]."""
    arm = heavy_arm(p)
    before = arm.q
    arm.advance(0.0)
    arm.advance(0.15)
    return np.abs(arm.q - before)[3]


def turned(p: PhysicsParameters):
    """By the first joint in 0.4 s, of which it is commanded 0.2 s at 0.5 rad/s [rad]."""
    arm = heavy_arm(p)
    begin = arm.q[0]
    arm.advance(0.0)
    for i in range(50):
        arm.command(i * DT, np.array([0.5, *[0.0] * (len(arm.q) - 1)]))
        arm.advance((i + 1) * DT)
    arm.advance(0.4)
    return arm.q[0] - begin


POSE = looking((1.6, 0.4, 1.1), (0.0, 0.0, 0.4))
ARM = arm_of(PANDA, PANDA_READY)
BACKDROP = body('box', (-1.8, 0.0, 0.0), (0.1, 4.0, 4.0))
BALL = body('ellipsoid', (0.5, 0.4, 0.6), (0.1, 0.1, 0.1))
FAR = body('ellipsoid', (-1.6, -0.9, 0.4), (0.1, 0.1, 0.1))
SCENE = together(ARM, BALL, FAR)


def voxels(p: CloudParameters):
    """That a cloud of the arm and two balls makes, one ball just out of reach."""
    return len(CloudFilter(PANDA, p).see(
        seen(POSE, SCENE), POSE, still(PANDA_READY, np.full(7, 0.5)), 1.0))


def voxels_of_the_arm(p: CloudParameters):
    """Of the arm itself, seen while it moves."""
    return len(CloudFilter(PANDA, p).see(
        seen(POSE, ARM), POSE, still(PANDA_READY, np.full(7, 0.5)), 1.0))


def voxels_left_after_a_second(p: CloudParameters):
    """Of a ball that has gone, before a backdrop that shows it, or before nothing."""
    world = CloudFilter(PANDA, p)
    world.see(seen(POSE, together(ARM, BALL, BACKDROP)), POSE, still(PANDA_READY), 1.0)
    rest = together(ARM, BACKDROP) if p.ray_clearing and p.persistence > 5.0 else ARM
    return len(world.see(seen(POSE, rest), POSE, still(PANDA_READY), 2.0))


def cubes_of_a_map(p: SceneParameters):
    """All is occupied around the arm, in cubes of 0.8 m."""
    def node(depth):
        return (b'\0\0\0\0' + (b'\xff' + 8 * node(depth - 1) if depth else b'\0'))

    center, reach = reach_of(PANDA)
    return len(occupied(octomap(node(3), 1e-4, binary=False).octomap, center,
                        reach + p.scene_reach_margin).edges)


def camera_of(p: CameraParameters):
    return DepthCamera(p.image_width, p.image_height, p.field_of_view, p.camera_range,
                       p.camera_noise)


def points_of_a_ball(p: CameraParameters):
    """That the camera sees."""
    return np.isfinite(seen(POSE, BALL, camera_of(p))[0]).sum()


def points_of_everything(p: CameraParameters):
    return np.isfinite(seen(POSE, together(ARM, BACKDROP), camera_of(p))[0]).sum()


def roughness(p: CameraParameters):
    """Spread of the distances to a ball [m]."""
    cloud = seen(POSE, BALL, camera_of(p), np.random.default_rng(0))
    true = seen(POSE, BALL, camera_of(CameraParameters()))
    return float(np.nanstd(np.linalg.norm(cloud, axis=0) - np.linalg.norm(true, axis=0)))


def time_that_an_arm_may_stand(settings):
    """How long a joint that is told to move may stand before it is said not to follow [s]."""
    following = Following(('a',), DT, settings.follow_tolerance)
    following.begin(np.zeros(1))
    ticks = 0
    while not following.tick(np.array([0.3]), np.zeros(1), np.zeros(1)):
        ticks += 1
    return ticks * DT


MOUNTED = (('mount_frame', 'cell'),)
ON_A_BASE = (('base', 'holonomic'),)
DRIVES = (('base', 'holonomic'), ('base_weight', 0.1))
FALLING = (('servo', 'off'),)
HEAVY = (('mass_error', 0.3),)
CASES = [
    Case(RobotParameters, 'velocity_max', (0.2,), (1.0,), time_to_a_target, '-'),
    Case(RobotParameters, 'acceleration_max', (0.5,), (5.0,), time_to_a_target, '-'),
    Case(RobotParameters, 'acceleration_max', (0.5,), (5.0,), way_in_half_a_second, '+'),
    Case(RobotParameters, 'jerk_max', (10.0,), (500.0,), way_in_half_a_second, '+'),
    Case(RobotParameters, 'position_limits', (), ('d2=0.0..0.15',), way_in_half_a_second,
         '-'),
    Case(RobotParameters, 'link_radius', 0.0, 0.03, clearance_at_rest, '-'),
    Case(RobotParameters, 'axes', ('vx', 'vy', 'vz'), ('vx', 'vy', 'vz', 'wx', 'wy', 'wz'),
         least_norm_speed, '+'),
    Case(RobotParameters, 'command_frame', 'tool', 'base', rise_of_the_tip, '+'),
    Case(RobotParameters, 'base_weight', 1.0, 30.0, way_of_the_base, '-', ON_A_BASE),
    Case(RobotParameters, 'base_speed', (0.02, 1.0), (0.5, 1.0), way_of_the_base, '+', DRIVES),
    Case(RobotParameters, 'base_acceleration', (0.02, 1.0), (0.5, 1.0), way_of_the_base, '+',
         DRIVES),
    Case(RobotParameters, 'base_room', 0.1, 5.0, way_of_the_base, '+', DRIVES),
    Case(RobotParameters, 'locked_joints', (), ('panda_joint3=0.0',), number_of_joints, '-'),
    Case(RobotParameters, 'mount_pose', (0.0, 0.0, 0.0), (0.0, 0.0, 0.5), height_of_the_tip, '+',
         MOUNTED),
    Case(PlannerNodeParameters, 'incoming_command_timeout', 0.1, 0.6, time_that_a_twist_counts,
         '+'),
    Case(PlannerNodeParameters, 'joint_state_timeout', 0.1, 0.5, time_that_a_measurement_counts,
         '+'),
    Case(PlannerNodeParameters, 'follow_tolerance', 0.01, 0.1, time_that_an_arm_may_stand, '+'),
    Case(PlannerNodeParameters, 'estimate_obstacle_velocity', False, True, believed_speed, '+'),
    Case(PlannerNodeParameters, 'workspace', (), (-1.0, -1.0, -1.0, 1.0, 1.0, 0.8), way_up, '-'),
    Case(FakeHardwareParameters, 'command_timeout', 0.05, 0.2, way_after_the_last_command, '+'),
    Case(PhysicsParameters, 'command_timeout', 0.02, 0.1, turned, '+'),
    Case(PhysicsParameters, 'lag', 0.0, 0.2, turned, '-'),
    Case(PhysicsParameters, 'servo', 'velocity', 'off', sag, '+'),
    Case(PhysicsParameters, 'servo_bandwidth', 5.0, 20.0, sag, '-', HEAVY),
    Case(PhysicsParameters, 'mass_error', 0.1, 0.3, sag, '+'),
    Case(PhysicsParameters, 'armature', 0.1, 2.0, sag, '-', FALLING),
    Case(PhysicsParameters, 'joint_damping', 1.0, 30.0, sag, '-', FALLING),
    Case(PhysicsParameters, 'gravity', (0.0, 0.0, -1.6), (0.0, 0.0, -9.81), sag, '+', FALLING),
    Case(CloudParameters, 'reach_margin', 0.0, 1.0, voxels, '+', (('min_points', 1),)),
    Case(CloudParameters, 'self_margin', 0.0, 0.05, voxels_of_the_arm, '-',
         (('stamp_uncertainty', 0.0),)),
    Case(CloudParameters, 'stamp_uncertainty', 0.0, 0.2, voxels_of_the_arm, '-',
         (('self_margin', 0.0),)),
    Case(CloudParameters, 'voxel_size', 0.02, 0.05, voxels, '-'),
    Case(CloudParameters, 'min_points', 1, 4, voxels, '-'),
    Case(CloudParameters, 'crop_box', (), (-2.0, -2.0, -1.0, 2.0, 0.0, 2.0), voxels, '-'),
    Case(CloudParameters, 'persistence', 0.5, 5.0, voxels_left_after_a_second, '+'),
    Case(CloudParameters, 'ray_clearing', False, True, voxels_left_after_a_second, '-',
         (('persistence', 9.0),)),
    Case(SceneParameters, 'scene_reach_margin', 0.0, 2.0, cubes_of_a_map, '+'),
    Case(CameraParameters, 'image_width', 80, 320, points_of_a_ball, '+'),
    Case(CameraParameters, 'image_height', 60, 240, points_of_everything, '+'),
    Case(CameraParameters, 'field_of_view', 0.8, 1.6, points_of_a_ball, '-'),
    Case(CameraParameters, 'camera_range', 2.0, 10.0, points_of_everything, '+'),
    Case(CameraParameters, 'camera_noise', 0.0, 0.02, roughness, '+'),
]

# Without more or less: what the nodes' live tests and those of io/ hold them to.
NAMES_SOMETHING = {
    RobotParameters: {
        'urdf', 'robot_description', 'base_frame', 'tip_frame', 'tips', 'base', 'mount_frame',
        'capsules',
        'link_shapes'},
    PlannerNodeParameters: {
        'rate', 'enable_stamped_cmd_vel', 'obstacle_topics', 'outputs', 'publish_ticks',
        'thread_priority', 'static_obstacles', 'drive_goes_on'},
    FakeHardwareParameters: {
        'rate', 'initial_joints', 'initial_positions', 'lag', 'noise', 'wrap_continuous',
        'thread_priority'},
    PhysicsParameters: {'physics_rate'},
    CloudParameters: {'sensor_pose', 'sensor_frame', 'self_capsules'},
    SceneParameters: {'scene_planner', 'allowed_contacts'},
    CameraParameters: {'camera_rate', 'camera_frame', 'camera_pose'},
}


def test_every_parameter_has_a_case_or_no_direction():
    for settings, names in NAMES_SOMETHING.items():
        directed = {case.name for case in CASES if case.settings is settings}
        assert not directed & names
        assert directed | names == {entry.name for entry in fields(settings)}, settings.__name__


@pytest.mark.parametrize('case', CASES, ids=lambda case: f'{case.name}-{case.quantity.__name__}')
def test_a_parameter_acts_in_the_direction_that_it_says(case):
    def measured(value):
        return float(case.quantity(case.settings(**dict(case.others), **{case.name: value})))

    low, high = measured(case.low), measured(case.high)
    growth = high - low if case.sign == '+' else low - high
    assert growth > LEAST_SHARE * max(abs(low), abs(high)), f'{low:.4g} → {high:.4g}'

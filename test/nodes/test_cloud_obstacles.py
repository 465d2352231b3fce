"""From a depth camera to markers, over real topics."""

from __future__ import annotations

import time

from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from forked_nodes import ForkedProcesses
from live_helpers import LIVE, run_node, station
import numpy as np
import pytest
from rcl_interfaces.msg import Log, Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import deserialize_message, serialize_message
from ros_domains import next_domain
from sensor_msgs.msg import PointCloud2, PointField
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.analysis.metrics import smallest_clearance
from redundant_planner.analysis.replay_inputs import read_inputs
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.cloud_writer import cloud_bytes
from redundant_planner.io.parameter_files import settings_of
from redundant_planner.io.recording import read_recording
from redundant_planner.io.scenario import load_scenario
from redundant_planner.nodes.messages import markers_of
from redundant_planner.tools.live_run import play
from redundant_planner.tools.replayed_ticks import again, differences

pytestmark = LIVE
FILES = [ROBOTS / 'panda.yaml', ROBOTS.parent / 'perception' / 'panda.yaml']
VALUES = {'urdf': PANDA_URDF}
START = {'urdf': PANDA_URDF, 'initial_joints': [f'panda_joint{i}' for i in range(1, 8)],
         'initial_positions': PANDA_READY.tolist()}
BALL = Obstacle('ball', [0.45, 0.45, 0.5], [0.1, 0.1, 0.1])
# Far behind all that, out of the arm's reach: what the camera sees when nothing is before it.
BACKDROP = Obstacle.box('backdrop', [-1.8, 0.0, 0.0], [0.1, 9.0, 9.0])
BASE = 'panda_link0'


class Seer:
    """A node cloud_obstacles, what it says, and a way to show it clouds."""

    def __init__(self, ros, processes, files=FILES, **values):
        self.ros = ros
        self.said: list[str] = []
        self.markers: list[Marker] = []
        node = ros.node
        node.create_subscription(Log, '/rosout', lambda m: self.said.append(m.msg), 100)
        node.create_subscription(
            MarkerArray, 'obstacles', lambda m: self.markers.extend(m.markers), 10)
        self.points = node.create_publisher(PointCloud2, 'points', qos_profile_sensor_data)
        self.process = processes.start('cloud_obstacles', files, {**VALUES, **values})

    def show(self, points, frame=BASE, stamp_ns=None):
        """Publish points (k, 3) as of the latest joint states."""
        if stamp_ns is None:
            stamp = self.ros.states[-1].header.stamp
            stamp_ns = stamp.sec * 10**9 + stamp.nanosec
        self.points.publish(cloud_bytes(np.array(points, float)[None], frame, stamp_ns))

    def until(self, condition, what, points=((9.0, 9.0, 9.0),), **options):
        """Show a cloud again and again until a condition holds."""
        def again():
            self.show(points, **options)
            self.ros.spin(0.02)

        self.ros.wait_for(condition, what, meanwhile=again)

    def settle(self):
        """Wait until all clouds shown so far have come through, and forget their markers."""
        end = time.monotonic() + 0.5
        self.ros.wait_for(lambda: time.monotonic() > end, 'half a second')
        self.markers.clear()

    def says(self, text):
        self.said.clear()
        return lambda: any(text in said for said in self.said)

    def cubes(self):
        """The centres (k, 3) in the latest marker; none after DELETE."""
        marker = self.markers[-1]
        assert (marker.ns, marker.id, marker.type) == ('cloud', 0, Marker.CUBE_LIST)
        assert marker.header.frame_id == BASE
        assert (marker.action == Marker.DELETE) == (not marker.points)
        return np.array([[p.x, p.y, p.z] for p in marker.points]).reshape(-1, 3)


@pytest.fixture(scope='module')
def seer():
    with station() as (ros, processes):
        processes.start('fake_hardware_node', [ROBOTS / 'panda.yaml'], START)
        seer = Seer(ros, processes, min_points=1, persistence=0.3)
        ros.wait_for(lambda: ros.states and seer.points.get_subscription_count(), 'start')
        seer.until(lambda: seer.markers, 'the first markers')
        yield seer


def changed(**changes):
    """A good cloud of one point, with some fields changed."""
    cloud = PointCloud2(height=1, width=1, point_step=12, row_step=12, data=bytes(12))
    cloud.fields = [PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
                    for i, name in enumerate('xyz')]
    cloud.header.frame_id, cloud.header.stamp.sec = BASE, 1
    for name, value in changes.items():
        setattr(cloud, name, value)
    return bytes(serialize_message(cloud))


@pytest.mark.parametrize(('raw', 'reason'), [
    (changed(data=bytes(13)), 'its data has 13 bytes; 1 rows of 12 bytes take 12'),
    (changed(fields=[]), "it has no field 'x', 'y', 'z'"),
    (changed(fields=[PointField(name=n, datatype=PointField.INT16, count=1) for n in 'xyz']),
     "its field 'x' has datatype 3 (INT16); it must be 7 (FLOAT32)"),
    (changed(point_step=0), 'its point_step is 0'),
    (changed()[:-8], 'its data should have 12 bytes'),
    (b'\0\1\0\0' + 99 * b'\xff', 'the nanosec of its stamp is 4294967295'),
    (b'\0\1\0\0' + 8 * b'\0' + 91 * b'\xff', 'up to 255 are read'),
])
def test_a_damaged_cloud_is_refused_by_name_and_hurts_nobody(seer, raw, reason):
    seer.ros.wait_for(seer.says(reason), reason, meanwhile=lambda: seer.points.publish(raw))
    seer.markers.clear()
    seer.until(lambda: seer.markers and len(seer.cubes()) == 1, 'a voxel', [[0.5, 0.4, 0.8]])
    np.testing.assert_allclose(seer.cubes(), [[0.5125, 0.4125, 0.8125]])
    assert seer.process.poll() is None


@pytest.mark.parametrize(('options', 'reason'), [
    ({'frame': 'moon'}, "they are in frame 'moon', and nobody knows where that is: sensor_pose "
                        "is that of 'camera'"),
    ({'frame': ''}, "they are in frame ''"),
    ({'stamp_ns': 0}, 'its stamp is 0 s; it must say when it was taken'),
    ({'stamp_ns': 10**9}, 's earlier than the oldest joint_states'),
    ({'stamp_ns': 2 * 10**18}, 's later than the newest joint_states'),
])
def test_a_cloud_without_a_known_place_and_posture_is_skipped_with_the_reason(
        seer, options, reason):
    seer.until(lambda: seer.markers and not len(seer.cubes()), 'nothing to be seen')
    seer.settle()
    heard = seer.says(reason)
    # A late one would wait for its joint states, and the others behind it.
    seer.ros.wait_for(heard, reason, meanwhile=lambda: (
        seer.show([[0.5, 0.4, 0.8]], **options), seer.ros.spin(0.1)))
    assert not seer.markers
    assert seer.process.poll() is None


def test_the_arm_is_taken_out_where_it_is(seer):
    arm = make_panda().kinematics(PANDA_READY)
    on_arm = np.concatenate([arm.segment_start, arm.segment_end, [[-0.05, 0.0, 0.07]]])
    other = [[0.5, 0.4, 0.8]]
    seer.markers.clear()
    seer.until(lambda: seer.markers and len(seer.cubes()), 'a voxel', [*on_arm, *other])
    np.testing.assert_allclose(seer.cubes(), [[0.5125, 0.4125, 0.8125]])


def test_what_the_hand_holds_is_taken_out_until_it_lets_go(seer):
    attached = seer.ros.node.create_publisher(MarkerArray, 'attached', 10)
    panda = make_panda()
    arm = panda.kinematics(PANDA_READY)
    held = [arm.tip_position + arm.tip_rotation @ [0.0, 0.0, 0.25]]
    seer.ros.wait_for(attached.get_subscription_count, 'listener')
    seer.until(lambda: len(seer.cubes()) == 1, 'a voxel', held)
    attached.publish(markers_of(
        [Obstacle('cup', (0.0, 0.0, 0.25), (0.05, 0.05, 0.05))], panda.tip_frame))
    seer.until(lambda: len(seer.cubes()) == 0, 'an arm with a cup', held)
    attached.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
    seer.until(lambda: len(seer.cubes()) == 1, 'a voxel again', held)


def test_what_is_no_longer_seen_goes_after_its_time_and_clear_forgets_at_once(seer):
    there = [[0.5, 0.4, 0.8], [0.6, 0.4, 0.8]]
    seer.until(lambda: len(seer.cubes()) == 2, 'two voxels', there)
    seer.until(lambda: len(seer.cubes()) == 0, 'none')
    seer.until(lambda: len(seer.cubes()) == 2, 'two voxels', there)
    client = seer.ros.node.create_client(Trigger, '/cloud_obstacles/clear')
    seer.ros.wait_for(client.service_is_ready, 'service')
    answer = client.call_async(Trigger.Request())
    seer.ros.wait_for(answer.done, 'answer')
    assert answer.result().success and answer.result().message == 'forgot 2 voxels'


def test_parameters_change_while_it_runs_and_bad_ones_are_refused(seer):
    client = seer.ros.node.create_client(SetParameters, '/cloud_obstacles/set_parameters')
    seer.ros.wait_for(client.service_is_ready, 'service')

    def set_to(name, value):
        answer = client.call_async(SetParameters.Request(parameters=[Parameter(
            name=name, value=value)]))
        seer.ros.wait_for(answer.done, name)
        return answer.result().results[0]

    def floats(*values):
        return ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY,
                              double_array_value=values)

    point = [[0.5, 0.4, 0.8]]
    seer.until(lambda: len(seer.cubes()) == 1, 'a voxel', point)
    assert set_to('crop_box', floats(0.0, 0.0, 0.0, 0.4, 1.0, 1.0)).successful
    seer.until(lambda: len(seer.cubes()) == 0, 'nothing within the box', point)
    refused = set_to('crop_box', floats(1.0, 2.0))
    assert not refused.successful and 'has 2 entries; it takes 6' in refused.reason
    refused = set_to('sensor_pose', floats(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0))
    assert not refused.successful and 'has length 2; it must be 1' in refused.reason
    assert not set_to('voxel_size', ParameterValue(
        type=ParameterType.PARAMETER_DOUBLE, double_value=0.1)).successful
    assert set_to('crop_box', floats(-2.0, -2.0, 0.02, 2.0, 2.0, 2.0)).successful
    seer.until(lambda: len(seer.cubes()) == 1, 'a voxel again', point)


def test_what_a_camera_sees_of_an_obstacle_is_covered_and_gone_with_it():
    """Fake hardware, the test camera and cloud_obstacles; before a backdrop it clears at once."""
    with station() as (ros, processes):
        world = ros.node.create_publisher(MarkerArray, 'camera_obstacles', 10)
        processes.start('fake_hardware_node', [ROBOTS / 'panda.yaml'], START)
        processes.start('depth_camera', FILES, VALUES)
        seer = Seer(ros, processes, persistence=600.0)
        # Raw: nobody here needs to make an object of each point.
        clouds: list[bytes] = []
        ros.node.create_subscription(PointCloud2, 'points', clouds.append,
                                     qos_profile_sensor_data, raw=True)
        ros.wait_for(lambda: seer.markers and world.get_subscription_count(), 'start')
        assert len(seer.cubes()) == 0  # the arm alone
        world.publish(markers_of([BALL, BACKDROP], BASE))
        ros.wait_for(lambda: len(seer.cubes()) > 30, 'the ball')
        ros.wait_for(lambda: clouds, 'a cloud')
        cloud = deserialize_message(clouds[-1], PointCloud2)
        assert (cloud.header.frame_id, cloud.height, cloud.width) == ('camera', 240, 320)
        cubes = seer.cubes()
        away = np.linalg.norm(cubes - BALL.center, axis=1)
        # All of them at the ball's surface, half of which the camera sees.
        assert (np.abs(away - 0.1) < 0.5 * np.sqrt(3.0) * 0.025).all()
        random = np.random.default_rng(0).normal(size=(400, 3))
        normals = random / np.linalg.norm(random, axis=1)[:, None]
        facing = normals @ (np.array([1.5, 0.0, 1.2]) - BALL.center) > 0.5
        surface = (BALL.center + 0.1 * normals)[facing]
        gaps = np.abs(surface[:, None] - cubes).max(axis=2).min(axis=1)
        assert (gaps <= 0.5 * 0.025 + 1e-4).mean() > 0.97
        world.publish(MarkerArray(markers=[
            Marker(ns='ball', id=0, action=Marker.DELETE)]))
        ros.wait_for(lambda: len(seer.cubes()) == 0, 'the way free')


@pytest.mark.long
def test_a_panda_passes_what_only_a_camera_sees_and_its_bag_replays_exactly(tmp_path):
    """Camera, cloud_obstacles and planner_node; the carton itself is judged, not its voxels."""
    file = ROBOTS.parent / 'scenarios' / 'panda_camera.yaml'
    scenario, panda = load_scenario(file), make_panda()
    carton = [one for one in scenario.obstacles if one.name == 'carton']
    unaware = [np.array(PANDA_READY)]
    for i in range(500):
        unaware.append(unaware[-1] + 0.01 * np.linalg.pinv(
            panda.kinematics(unaware[-1]).jacobian) @ scenario.twist_at(0.01 * i))
    assert smallest_clearance(panda, np.array(unaware), carton).level < -0.1
    bag = play(scenario, file, tmp_path / 'bag', camera_files=FILES[1:], domain_id=next_domain(),
               planner_values={'urdf': PANDA_URDF, 'publish_ticks': True}, kind=ForkedProcesses
               ).bag
    recording = read_recording(bag)
    assert len(recording.obstacles) > 20  # the voxels alone are what the planner knew
    postures = recording.states.select(panda.joint_names).positions
    assert smallest_clearance(panda, postures, carton).level > 0.0
    moved = np.diff([panda.kinematics(q).tip_position for q in postures[[0, -1]]], axis=0)[0]
    assert moved[1] > 0.5 * 0.06 * 5.0 and np.abs(moved[[0, 2]]).max() < 1e-3
    with open_bag(bag) as opened:
        inputs = read_inputs(opened, None, '', '')
    found = differences(inputs, again(inputs, settings_of(PlannerParameters, inputs.values)))
    assert len(found) > 500 and found.max() < 1e-9


def test_without_joint_states_nothing_is_seen_and_a_silent_camera_is_missed():
    with station() as (ros, processes):
        seer = Seer(ros, processes)
        ros.wait_for(seer.says('no points for'), 'a word about the silence')
        heard = seer.says('no joint_states have come')
        ros.wait_for(heard, 'the reason', meanwhile=lambda: (
            seer.show([[0.5, 0.4, 0.8]], stamp_ns=10**9), ros.spin(0.1)))
        assert not seer.markers and seer.process.poll() is None


@pytest.mark.parametrize(('node', 'values', 'reason'), [
    ('cloud_obstacles', ['sensor_pose:=[1.0, 2.0]'], "'sensor_pose' has 2 entries; it takes 7"),
    ('cloud_obstacles', ['voxel_size:=0.001'], "'voxel_size' is 0.001; it must lie in [0.005, 1]"),
    ('cloud_obstacles', ['crop_box:=[1.0, 0.0, 0.0, 0.5, 1.0, 1.0]'], 'x_min must be less'),
    ('cloud_obstacles', ['self_capsules:=[base]'], "capsule 'base' lacks 'frame'"),
    ('depth_camera', ['camera_pose:=[0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]'], 'has length 1.41'),
    ('depth_camera', ['image_width:=0'], "'image_width' is 0"),
])
def test_parameters_that_make_no_sense_end_a_node_with_the_reason(node, values, reason):
    arguments = [a for value in values for a in ('-p', value)]
    status, said = run_node(node, '--params-file', str(FILES[0]), '-p', f'urdf:={PANDA_URDF}',
                            *arguments)
    assert status == 2 and reason in said and 'Traceback' not in said, said

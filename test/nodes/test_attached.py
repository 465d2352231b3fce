"""What the hand holds, with real processes: from the message to the bag that replays it."""

from __future__ import annotations

from bench import ARM, ARM_VALUES, FILE, START
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from live_helpers import LIVE, station
import numpy as np
import pinocchio as pin
import pytest
from rcl_interfaces.msg import Log
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from topic_recorder import TopicRecorder
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.replay_inputs import read_inputs
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.parameter_files import settings_of
from redundant_planner.nodes.messages import markers_of
from redundant_planner.tools.replay_bag import main as replay_bag
from redundant_planner.tools.replayed_ticks import again, differences

pytestmark = LIVE

AT_START = ARM.kinematics([START.get(name, 0.0) for name in ARM.joint_names])
TIP = AT_START.tip_position
# A rod across the arm's way, 30 cm to either side of the tip: along x of the base.
ROD = Obstacle.capsule('rod', (0.0, 0.0, 0.0), 0.01, 0.6, orientation=pin.Quaternion(
    np.array(AT_START.tip_rotation.T @ pin.rpy.rpyToMatrix(0.0, 0.5 * np.pi, 0.0))).coeffs())
TOPICS = {
    'joint_states': JointState, 'joint_command': JointState, 'cmd_vel': Twist,
    'obstacles': MarkerArray, 'attached': MarkerArray, 'planner_node/configuration': String,
    'planner_node/ticks': Float64MultiArray}


@pytest.fixture
def ros():
    with station() as (ros, processes):
        ros.attached = ros.node.create_publisher(MarkerArray, 'attached', 10)
        ros.recorder = TopicRecorder(ros, TOPICS)
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        ros.planner = processes.start('planner_node', FILE, {
            'publish_ticks': True, 'allowed_contacts': ['attached/rod:shelf']})
        ros.wait_for(lambda: ros.commands and ros.attached.get_subscription_count()
                     and ros.obstacles.get_subscription_count()
                     and ros.twist.get_subscription_count(), 'start')
        yield ros


def value(ros, key):
    return {v.key: v.value for s in ros.statuses[-1:] for v in s.values}.get(key)


@pytest.mark.long
def test_a_thing_is_taken_carried_past_others_and_let_go(ros, tmp_path):
    """It turns out of the way, is no obstacle meanwhile, and its bag replays."""
    there = [Obstacle('rod/0', TIP, (0.02, 0.02, 0.02)),
             Obstacle.box('post', TIP + [0.25, -0.12, 0.0], (0.05, 0.05, 0.4))]
    markers = markers_of(there, ARM.base_frame)
    markers.markers[0].ns, markers.markers[0].id = 'rod', 0
    held = markers_of([ROD], ARM.tip_frame)
    held.markers[0].ns, held.markers[0].id = 'rod', 0
    ros.attached.publish(held)
    ros.wait_for(lambda: value(ros, 'attached') == 'rod/0', 'the rod')
    ros.obstacles.publish(markers)
    ros.wait_for(lambda: value(ros, 'obstacles') == '1', 'all but the rod')
    forward = np.array([0.0, -0.1, 0.0, 0.0, 0.0, 0.0])
    nearest = set()

    def has_passed():
        nearest.add(value(ros, 'nearest pair'))
        return ARM.kinematics(ros.state(ARM.joint_names)).tip_position[1] < TIP[1] - 0.2

    ros.drive_until(forward, has_passed, 'the way past the post')
    assert any('attached/rod/0' in str(pair) and 'post/1' in str(pair) for pair in nearest)
    # Let go of it, take the obstacle of its name away, and the hand goes on.
    ros.attached.publish(MarkerArray(markers=[Marker(ns='rod', id=0, action=Marker.DELETE)]))
    ros.wait_for(lambda: value(ros, 'attached') == '' and value(ros, 'obstacles') == '2',
                 'an empty hand')
    ros.obstacles.publish(MarkerArray(markers=[Marker(ns='rod', id=0, action=Marker.DELETE)]))
    ros.wait_for(lambda: value(ros, 'obstacles') == '1', 'the post alone')
    ros.statuses.clear()
    ros.drive_until(forward, lambda: float(value(ros, 'twist scale s') or 0.0) > 0.9, 'motion')
    ros.wait_for(ros.at_rest, 'rest')
    assert ros.planner.poll() is None

    ros.recorder.write(tmp_path / 'bag')
    with open_bag(tmp_path / 'bag') as opened:
        inputs = read_inputs(opened, None, '', '')
    assert {tick.attached_messages for _, tick in inputs.ticks} >= {1, 2}
    found = differences(inputs, again(inputs, settings_of(PlannerParameters, inputs.values)))
    assert len(found) > 200 and found.max() < 1e-9
    assert replay_bag([str(tmp_path / 'bag'), '--out', str(tmp_path / 'again')]) == 0
    analysis = analyse(tmp_path / 'bag')
    assert analysis.clearance.link == 'attached/rod/0' and analysis.clearance.obstacle == 'post/1'
    assert 0.0 < analysis.distance < 0.1


def test_what_cannot_be_held_is_refused_by_name_and_the_node_lives_on(ros):
    said = []
    ros.node.create_subscription(Log, '/rosout', lambda message: said.append(message.msg), 100)
    ball = Obstacle('ball', (0.0, 0.0, 0.1), (0.01, 0.01, 0.01))
    for things, frame, reason in (
            ([ROD], 'elsewhere', "attached obstacle 'rod/0' is given in frame 'elsewhere'; it "
                                 f"must be in '{ARM.tip_frame}'"),
            ([ball] * 70, ARM.tip_frame, 'what it holds stays as it was: what is '
                                         'attached takes 70 capsules')):
        message = markers_of(things, frame)
        ros.wait_for(lambda reason=reason: any(reason in line for line in said), reason,
                     meanwhile=lambda message=message: (
                         ros.attached.publish(message), ros.spin(0.2)))
    ros.attached.publish(MarkerArray(markers=[
        Marker(action=Marker.DELETEALL), *markers_of([ROD], ARM.tip_frame).markers]))
    ros.wait_for(lambda: value(ros, 'attached') == 'rod/0', 'the rod')
    ros.drive_until(np.array([0.0, 0.0, 0.05, 0, 0, 0]), ros.moves, 'motion')
    assert ros.planner.poll() is None
    assert ros.statuses[-1].level != DiagnosticStatus.ERROR

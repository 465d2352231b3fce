"""How well an arm followed its chunks, from motions whose lag and deviation are known."""

from __future__ import annotations

from bags import KINDS, ns
from builtin_interfaces.msg import Duration, Time
from conftest import HANDS, make_two_handed, PANDA_URDF, two_handed_urdf
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path as PathMessage
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
import yaml

from redundant_planner import Robot
from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.measure_tables import chunk_rows, motion_measures
from redundant_planner.analysis.planner_reports import PlannerReports
from redundant_planner.analysis.report import page_of
from redundant_planner.core.robot.quaternions import quaternion_of
from redundant_planner.io.bag_writer import BagWriter
from redundant_planner.tools.analyze_bag import main as analyze_bag

DT, LAG, OFF = 0.01, 0.15, 0.03
REST = np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8])
TIP = 'panda_hand_tcp'


def planned(time):
    """Where a chunk has the joints at a time [s]."""
    q = REST.copy()
    q[0] += 0.4 * (1.0 - np.cos(max(time, 0.0)))
    q[3] += 0.2 * (1.0 - np.cos(2.0 * max(time, 0.0)))
    return q


def driven(time):
    """Where the arm is: behind, and off by a bump of joint 6 around 2 s."""
    q = planned(min(time - LAG, 3.0))
    q[5] += OFF * np.exp(-((time - 2.0) / 0.2) ** 2)
    return q


def stamp(time):
    return Time(sec=ns(time) // 10**9, nanosec=ns(time) % 10**9)


def trajectory(robot, begin, end):
    message = JointTrajectory(joint_names=list(robot.joint_names))
    message.header.stamp = stamp(begin)
    for i in range(round((end - begin) / 0.05) + 1):
        message.points.append(JointTrajectoryPoint(
            positions=planned(begin + 0.05 * i).tolist(),
            time_from_start=Duration(sec=int(0.05 * i), nanosec=round(0.05 * i % 1 * 1e9))))
    return message


def path(robot, begin, end):
    message = PathMessage()
    message.header.frame_id, message.header.stamp = robot.base_frame, stamp(begin)
    for i in range(round((end - begin) / 0.05) + 1):
        arm = robot.kinematics(planned(begin + 0.05 * i))
        pose = PoseStamped()
        pose.header.stamp = stamp(begin + 0.05 * i)
        place, turn = pose.pose.position, pose.pose.orientation
        place.x, place.y, place.z = arm.tip_position.tolist()
        turn.x, turn.y, turn.z, turn.w = quaternion_of(arm.tip_rotation).tolist()
        message.poses.append(pose)
    return message


def said(message, reason=None):
    """A message of ~/target."""
    values = [] if reason is None else [KeyValue(key='limited by', value=reason)]
    return serialize_message(DiagnosticArray(status=[DiagnosticStatus(
        name='/planner_node: target', message=message, values=values)]))


@pytest.fixture(scope='module')
def robot():
    return Robot.from_urdf(str(PANDA_URDF), TIP)


def recorded(folder, robot, kind, chunks, *, twist_at=None, seconds=5.0):
    """A bag of an arm that is driven along chunks from begin to end [s], one after another."""
    topic = 'target_path' if kind is path else 'target_trajectory'
    with BagWriter(folder) as bag:
        for name in ('joint_states', 'cmd_vel'):
            bag.add_topic(f'/{name}', KINDS[name])
        bag.add_topic('/planner_node/target', 'diagnostic_msgs/msg/DiagnosticArray')
        bag.add_topic(f'/{topic}', 'nav_msgs/msg/Path' if kind is path
                      else 'trajectory_msgs/msg/JointTrajectory')
        for i in range(round(seconds / DT)):
            now = DT * i
            bag.write_joints('/joint_states', ns(now), robot.joint_names, driven(now), np.zeros(7))
            for begin, end in chunks:
                if abs(now - max(begin - 0.1, 0.02)) < 0.5 * DT:
                    bag.write(f'/{topic}', ns(now), serialize_message(kind(robot, begin, end)))
            bag.write('/planner_node/target', ns(now), said(
                'moving', 'a ball is in its way' if abs(now - 2.0) < 0.3 else ''))
            if twist_at is not None and abs(now - twist_at) < 0.5 * DT:
                bag.write_twist('/cmd_vel', ns(now), np.zeros(6))
    return folder


@pytest.mark.parametrize('kind', [trajectory, path], ids=['joints', 'tip'])
@pytest.mark.parametrize('chunks', [
    [(0.0, 3.0)], [(0.0, 1.0), (0.5, 1.5), (1.0, 2.0), (1.5, 2.5), (2.0, 3.0)]],
    ids=['one', 'several'])
def test_lag_and_deviation_are_those_of_the_motion(tmp_path, robot, kind, chunks):
    found = analyse(recorded(tmp_path / 'bag', robot, kind, chunks), urdf=str(PANDA_URDF), tip=TIP)
    (run, word), = found.chunks
    assert run.of_joints == (kind is trajectory) and run.chunks == len(chunks)
    assert run.lag_median == pytest.approx(LAG, abs=0.02)
    assert run.lag_longest == pytest.approx(LAG, abs=0.04)
    assert run.off_at == pytest.approx(2.0, abs=0.15) and word == 'a ball is in its way'
    if kind is trajectory:
        assert run.joint == robot.joint_names[5]
        assert run.off == pytest.approx(OFF, rel=0.02) and run.turned == 0.0
    else:
        # The wrist turns the hand by about what the joint is off, on a lever of some 0.2 m.
        assert run.turned == pytest.approx(OFF, rel=0.15)
        assert 0.1 * OFF < run.off < 0.3 * OFF
    assert run.ended == ''


def test_a_twist_ends_them_and_an_arm_that_follows_well_is_near(tmp_path, robot, capsys):
    bag = recorded(tmp_path / 'bag', robot, trajectory, [(0.0, 3.0)], twist_at=1.2)
    found = analyse(bag, urdf=str(PANDA_URDF), tip=TIP)
    (run, word), = found.chunks
    assert run.ended == 'cmd_vel' and run.end == pytest.approx(1.2, abs=0.02)
    assert run.off < 0.002 and word == ''
    assert run.lag_median == pytest.approx(LAG, abs=0.02)
    measures = motion_measures(found)
    assert measures['chunk_off_joint'] == run.off and measures['chunk_off_tip_mm'] is None
    assert analyze_bag([str(bag), '--urdf', str(PANDA_URDF), '--tip', TIP]) == 0
    printed = capsys.readouterr().out
    assert 'ended by' in printed and 'Behind its chunks, longest' in printed
    assert '<h2>Chunks</h2>' in page_of([found]) and 'cmd_vel' in page_of([found])


def test_chunks_that_the_planner_refuses_are_left_out(tmp_path, robot):
    folder = tmp_path / 'bag'
    over = trajectory(robot, 0.0, 1.0)
    unknown = trajectory(robot, 2.0, 3.0)
    unknown.joint_names[0] = 'elbow'
    backward = trajectory(robot, 2.0, 3.0)
    backward.points[3], backward.points[7] = backward.points[7], backward.points[3]
    elsewhere = path(robot, 2.0, 3.0)
    elsewhere.header.frame_id = 'table'
    with BagWriter(folder) as bag:
        bag.add_topic('/joint_states', KINDS['joint_states'])
        bag.add_topic('/target_trajectory', 'trajectory_msgs/msg/JointTrajectory')
        bag.add_topic('/target_path', 'nav_msgs/msg/Path')
        for i in range(300):
            bag.write_joints('/joint_states', ns(DT * i), robot.joint_names, REST, np.zeros(7))
            if i == 200:
                for message in (over, unknown, backward):
                    bag.write('/target_trajectory', ns(DT * i), serialize_message(message))
                bag.write('/target_path', ns(DT * i), serialize_message(elsewhere))
    found = analyse(folder, urdf=str(PANDA_URDF), tip=TIP)
    assert found.chunks == () and motion_measures(found)['chunk_lag_median_ms'] is None
    notes = ' '.join(found.notes)
    for part in ('they are over by their stamps', "it names 'elbow'", 'do not ascend',
                 "in frame 'table'"):
        assert part in notes, notes


def test_each_of_several_tips_has_chunks_of_its_own(tmp_path):
    """The left hand lags behind its path; the right one's ends with a twist, then all go on."""
    hands = make_two_handed()
    urdf, params, folder = tmp_path / 'hands.urdf', tmp_path / 'hands.yaml', tmp_path / 'bag'
    urdf.write_text(two_handed_urdf())
    params.write_text(yaml.safe_dump({'/**': {'ros__parameters': {
        'urdf': str(urdf), 'tips': list(HANDS), 'link_radius': 0.03,
        'link_shapes': 'straight'}}}))
    rest = 0.5 * (hands.position_min + hands.position_max) + 0.3

    def there(time, left=0.0):
        q = rest.copy()
        q[2:8] += 0.2 * (1.0 - np.cos(np.clip(time - left, 0.0, 2.98)))
        q[8:] += 0.2 * (1.0 - np.cos(max(time, 0.0)))
        return q

    def path_of(tip, begin, end):
        message = PathMessage()
        message.header.frame_id, message.header.stamp = hands.base_frame, stamp(begin)
        for i in range(round((end - begin) / 0.05) + 1):
            pose = PoseStamped()
            pose.header.stamp = stamp(begin + 0.05 * i)
            arm = hands.kinematics(there(begin + 0.05 * i))
            place, turn = pose.pose.position, pose.pose.orientation
            place.x, place.y, place.z = arm.tip_positions[tip].tolist()
            turn.x, turn.y, turn.z, turn.w = quaternion_of(arm.tip_rotations[tip]).tolist()
            message.poses.append(pose)
        return serialize_message(message)

    with BagWriter(folder) as bag:
        bag.add_topic('/joint_states', KINDS['joint_states'])
        for hand in HANDS:
            bag.add_topic(f'/{hand}/target_path', 'nav_msgs/msg/Path')
            bag.add_topic(f'/{hand}/cmd_vel', KINDS['cmd_vel'])
        for i in range(400):
            now = DT * i
            bag.write_joints('/joint_states', ns(now), hands.joint_names, there(now, LAG),
                             np.zeros(hands.n))
            if i in (2, 100):
                begin = DT * i - 0.02
                bag.write('/left_hand/target_path', ns(now), path_of(0, begin, begin + 2.0))
            if i == 5:
                bag.write('/right_hand/target_path', ns(now), path_of(1, 0.0, 3.0))
            if i == 200:
                bag.write_twist('/right_hand/cmd_vel', ns(now), np.zeros(6))
    found = analyse(folder, params=params)
    assert len(found.chunks) == 2, found.notes
    (left, _), (right, _) = found.chunks
    assert (left.tip, right.tip) == HANDS and not left.of_joints
    assert (left.chunks, right.chunks) == (2, 1)
    assert left.lag_median == pytest.approx(LAG, abs=0.02)
    assert right.lag_median == pytest.approx(0.0, abs=0.02)
    assert max(left.off, right.off) < 1e-3
    assert left.ended == '' and right.ended == 'right_hand/cmd_vel'
    assert right.end == pytest.approx(2.0, abs=0.02)
    assert [row[0] for row in chunk_rows(found)] == ['2 of left_hand', '1 of right_hand']


@pytest.mark.parametrize(('words', 'time', 'said_then'), [
    ([], 1.0, ''), ([(1.0, 'a wall')], 0.9, 'a wall'), ([(1.0, 'a wall')], 0.5, ''),
    ([(1.0, 'a wall'), (2.0, '')], 2.2, 'a wall'), ([(1.0, 'a wall'), (2.0, '')], 2.5, ''),
    ([(1.0, 'a wall'), (2.0, 'a ball')], 2.1, 'a ball')])
def test_the_word_is_that_of_about_the_time(words, time, said_then):
    """It is said 20 times a second, and the arm lags behind what is decided."""
    assert PlannerReports(of_target=words).word_at(time) == said_then
    assert PlannerReports(of_itself=words).word_at(time) == said_then
    assert PlannerReports(of_target=[(0.0, 'its target')], of_itself=words).word_at(
        time) == 'its target'

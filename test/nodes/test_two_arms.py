"""Two arms in each other's reach, with real processes and the files that users start them with."""

from __future__ import annotations

from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from live_helpers import LIVE, station
import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from topic_recorder import TopicRecorder
from visualization_msgs.msg import MarkerArray

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from redundant_planner.analysis.replay_inputs import read_inputs
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.parameter_files import settings_of
from redundant_planner.io.robot_files import robot_of_values
from redundant_planner.tools.replay_bag import main as replay_bag
from redundant_planner.tools.replayed_ticks import again, differences

pytestmark = LIVE

SIDES = ('left', 'right')
FILES = [ROBOTS / 'panda.yaml', ROBOTS.parent / 'planner' / 'two_arms.yaml']
NAMES = list(make_panda().joint_names)
START = {'initial_joints': NAMES, 'initial_positions': PANDA_READY.tolist()}
# Both hands over the middle of the other side's table: their ways cross.
GOALS = {'left': PANDA_READY + [0.5, 0.5, 0.0, 0.5, 0.0, 0.3, 0.0],
         'right': PANDA_READY + [0.5, 0.5, 0.0, 0.5, 0.0, 0.3, 0.0]}
OF_EACH = {'joint_states': JointState, 'joint_command': JointState, 'cmd_vel': Twist,
           'target_joints': JointState, 'planner_node/configuration': String,
           'planner_node/ticks': Float64MultiArray, 'planner_node/body': MarkerArray}


def posture_of(message):
    return [message.position[message.name.index(name)] for name in NAMES]


def test_both_arrive_without_a_touch_and_each_ones_bag_replays(tmp_path):
    topics = {f'{side}/{topic}': kind for side in SIDES for topic, kind in OF_EACH.items()}
    with station() as (ros, processes):
        recorder, states, progress, targets = TopicRecorder(ros, topics), {}, {}, {}
        for side in SIDES:
            states[side], progress[side] = [], ['']
            ros.node.create_subscription(
                JointState, f'/{side}/joint_states', states[side].append, 100)
            ros.node.create_subscription(
                DiagnosticArray, f'/{side}/planner_node/target',
                lambda m, side=side: progress[side].extend(s.message for s in m.status),
                QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL))
            targets[side] = ros.node.create_publisher(JointState, f'/{side}/target_joints', 10)
            remap = {'__ns': f'/{side}'}
            processes.start('fake_hardware_node', FILES, {'urdf': PANDA_URDF, **START}, remap)
            processes.start('planner_node', FILES,
                            {'urdf': PANDA_URDF, 'rate': 100, 'publish_ticks': True}, remap)
        ros.wait_for(lambda: all(
            states[side] and targets[side].get_subscription_count()
            and ros.node.count_subscribers(f'/{side}/planner_node/body') >= 2
            for side in SIDES), 'start')
        ros.wait_for(lambda: {topic for topic, _, _ in recorder.messages} >= {
            f'{side}/{topic}' for side in SIDES
            for topic in ('planner_node/body', 'joint_command')}, 'bodies, and permission to move')
        for side in SIDES:
            targets[side].publish(JointState(name=NAMES, position=GOALS[side].tolist()))
        ros.wait_for(lambda: all(progress[side][-1] == 'reached' for side in SIDES), 'reached')
        # A state from before may come after that word, so the arms are waited for as well.
        ros.wait_for(lambda: all(
            np.allclose(posture_of(states[side][-1]), GOALS[side], rtol=0.0, atol=1e-3)
            for side in SIDES), 'the goals')
        recorder.write(tmp_path / 'bag')
    motions = []
    for side in SIDES:
        with open_bag(tmp_path / 'bag', side) as opened:
            inputs = read_inputs(opened, None, '', '')
        robot = robot_of_values(inputs.values)
        assert robot.base_frame == 'cell'
        # The other arm is among the inputs, and the replay is exact with it.
        assert inputs.ticks[-1][1].checked_messages[1][0] > 20 and len(inputs.obstacles[1]) > 20
        found = differences(inputs, again(inputs, settings_of(PlannerParameters, inputs.values)))
        assert len(found) > 50 and found.max() < 1e-9
        times = np.array([tick.time for _, tick in inputs.ticks])
        motions.append((robot, times, np.array([tick.q for _, tick in inputs.ticks])))
    # Both at the same moments, by the system's clock that both loops run by.
    grid = np.arange(max(times[0] for _, times, _ in motions),
                     min(times[-1] for _, times, _ in motions), 0.01)
    left, right = (Motion.through(capsules_of(robot), np.array(
        [np.interp(grid, times, column) for column in q.T]).T) for robot, times, q in motions)
    assert left.to_other(right).distance > 0.0
    assert replay_bag([str(tmp_path / 'bag'), '--namespace', 'right', '--method', 'variational',
                       '--out', str(tmp_path / 'other')]) == 0

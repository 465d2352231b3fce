"""From MoveIt's planning scene to a planner that steps around it, over real topics.

Twice where moveit_msgs is installed: with its messages, and with stand-ins for them.
"""

from __future__ import annotations

import importlib.util
import time

from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from live_helpers import LIVE, run_node, station
import numpy as np
import pytest
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters
import scene_messages as m
from scene_stand_in import Sender
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner

pytestmark = LIVE
INSTALLED = importlib.util.find_spec('moveit_msgs') is not None
FILES = [ROBOTS / 'panda.yaml']
VALUES = {'urdf': PANDA_URDF}
START = {'urdf': PANDA_URDF, 'initial_joints': [f'panda_joint{i}' for i in range(1, 8)],
         'initial_positions': PANDA_READY.tolist()}
PANDA = make_panda()
AT_START = PANDA.kinematics(PANDA_READY)
HAND = 'panda_hand'
# Contacts that planner and node are given, and one that the planner alone is given.
OWN, OTHER = 'panda_link7:shelf', 'panda_link6:lamp'
# Ahead of the tip, on its way to negative y.
WALL = AT_START.tip_position + [0.0, -0.3, 0.0]


def box(name, position, *size, **fields):
    return m.thing(name, at=m.pose(np.asarray(position).tolist()), frame=PANDA.base_frame,
                   primitives=[m.primitive(m.BOX, *size)], **fields)


class Bridge:
    """The node, who speaks to it, and what a planner makes of it."""

    def __init__(self, ros, processes, moveit):
        self.ros, self.processes = ros, processes
        self.said: list[str] = []
        self.markers: list[Marker] = []
        ros.node.create_subscription(Log, '/rosout', lambda log: self.said.append(log.msg), 100)
        ros.node.create_subscription(
            MarkerArray, 'obstacles', lambda array: self.markers.extend(array.markers), 10)
        self.held: list[Marker] = []
        ros.node.create_subscription(
            MarkerArray, 'attached', lambda array: self.held.extend(array.markers), 10)
        self.sender = Sender(ros.node, moveit)
        processes.start('fake_hardware_node', FILES, START)
        self.start_planner()
        self.process = processes.start(
            'planning_scene_obstacles' if moveit else 'scene_stand_in', FILES,
            {**VALUES, 'allowed_contacts': [OWN]})
        ros.wait_for(lambda: self.sender.heard('planning_scene') and ros.statuses
                     and ros.twist.get_subscription_count(), 'start')

    def start_planner(self):
        self.planner = self.processes.start(
            'planner_node', FILES, {**VALUES, 'allowed_contacts': [OWN, OTHER]},
            name='the planner')

    def value(self, key):
        return {v.key: v.value for s in self.ros.statuses[-1:] for v in s.values}.get(key)

    def until(self, obstacles, attached=''):
        self.ros.wait_for(lambda: (self.value('obstacles'), self.value('attached'))
                          == (obstacles, attached), f'{obstacles} obstacles, {attached!r} in hand')

    def until_allowed(self, *entries):
        found = [None]

        def ask():
            found[0] = list(self.ros.call(GetParameters, 'get_parameters', GetParameters.Request(
                names=['allowed_contacts'])).values[0].string_array_value)
            self.ros.spin(0.2)

        self.ros.wait_for(lambda: found[0] == list(entries), f'contacts {entries}', meanwhile=ask)

    def pause(self, seconds):
        end = time.monotonic() + seconds
        self.ros.wait_for(lambda: time.monotonic() > end, 'the end')

    def until_said(self, text):
        self.ros.wait_for(lambda: any(text in line for line in self.said), text)


@pytest.fixture(params=[False, pytest.param(True, marks=pytest.mark.skipif(
    not INSTALLED, reason='moveit_msgs is not installed; it is not on PyPI'))],
    ids=['stand-in', 'moveit_msgs'])
def bridge(request):
    with station() as (ros, processes):
        yield Bridge(ros, processes, request.param)


@pytest.mark.skipif(INSTALLED, reason='moveit_msgs is installed')
def test_without_moveit_msgs_the_node_ends_with_a_line_that_says_what_to_install():
    status, said = run_node('planning_scene_obstacles')
    assert status == 2
    assert said.startswith('planning_scene_obstacles: moveit_msgs cannot be imported (')
    assert 'sudo apt install ros-jazzy-moveit-msgs' in said and said.count('\n') == 1


def test_objects_are_avoided_held_let_go_and_told_to_planners_that_start_late(bridge):
    ros, sender = bridge.ros, bridge.sender
    table = box('table', (0.0, 0.6, 0.1), 0.4, 0.4, 0.1)
    wall = box('wall', WALL, 0.4, 0.05, 0.4)
    cup = box('cup', AT_START.tip_position + [0.0, 0.0, 0.25], 0.02, 0.02, 0.02)
    contacts = m.matrix(['cup', 'table', HAND], [('cup', 'table'), (HAND, 'table')])
    sender.send('planning_scene', m.scene([table, wall, cup], contacts=contacts))
    bridge.until('3')
    bridge.until_allowed(OWN, 'panda_hand:table')
    bridge.until_said(f"'{OTHER}' no longer count")

    # Into the wall, which stands across the way.
    scene = Scene.of([Obstacle.box('wall/0', WALL, (0.4, 0.05, 0.4))])
    planner = Planner(PANDA, PlannerParameters())
    ros.states.clear()
    ros.drive(np.array([0.0, -0.15, 0.0, 0.0, 0.0, 0.0]), 4.0)
    postures = [np.array([s.position[s.name.index(j)] for j in PANDA.joint_names])
                for s in ros.states[::10]]
    moved = PANDA.kinematics(postures[-1]).tip_position - AT_START.tip_position
    assert moved[1] < -0.05 and not any(planner.contacts(q, scene) for q in postures)

    # Into the hand without a shape of its own: it stays where it is.
    ros.wait_for(ros.at_rest, 'rest')
    sender.send('attached_collision_object', m.attached(HAND, m.thing('cup'), ['panda_link5']))
    bridge.until('2', 'cup/0')
    ros.wait_for(lambda: bridge.held, 'what the hand holds')
    at = bridge.held[-1].pose.position
    there = PANDA.in_base(ros.state(PANDA.joint_names), HAND, np.array([[at.x, at.y, at.z]]))[0]
    assert np.linalg.norm(there - AT_START.tip_position - [0.0, 0.0, 0.25]) < 1e-3
    bridge.until_allowed(OWN, 'attached/cup:table', 'panda_hand:table')
    bridge.until_said("keeps it from 'panda_link5' all the same")

    # A planner that starts anew learns of everything.
    bridge.planner.terminate()
    bridge.planner.wait(30.0)
    ros.statuses.clear()
    bridge.start_planner()
    bridge.until('2', 'cup/0')
    bridge.until_allowed(OWN, 'attached/cup:table', 'panda_hand:table')

    sender.send('attached_collision_object', m.attached('', m.thing('cup', m.REMOVE)))
    bridge.until('3')
    sender.send('collision_object', m.thing('', m.REMOVE))
    bridge.until('0')
    sender.send('collision_object', m.thing('odd', primitives=[m.primitive(m.SPHERE, -1.0)]))
    bridge.until_said("object 'odd', primitive 0 is a sphere with the dimensions [-1.0]")
    assert bridge.process.poll() is None


@pytest.mark.long
def test_move_group_is_asked_whenever_it_starts_and_counts_alone_while_it_speaks(bridge):
    ros, sender = bridge.ros, bridge.sender
    sender.offer(m.scene([box(name, (1.0, 0.0, y), 0.1, 0.1, 0.1) for y, name in enumerate('ab')],
                         is_diff=False, state_is_diff=False))
    bridge.until('2')
    assert sender.asked >= 1
    # It is gone and comes back with another scene.
    sender.leave()
    bridge.pause(3.0)
    bridge.until('2')
    sender.offer(m.scene([box('c', (1.0, 0.0, 0.0), 0.1, 0.1, 0.1)], is_diff=False))
    bridge.until('1')
    # What others ask of it counts once it says so, and not before.
    ros.wait_for(lambda: sender.heard('monitored_planning_scene'), 'a listener')
    bridge.pause(1.0)
    sender.send('collision_object', box('c', (1.0, 0.0, 0.5), 0.1, 0.1, 0.1, operation=m.APPEND))
    bridge.pause(1.0)
    bridge.until('1')
    # Sixteen levels down to one cube beside the origin of the map.
    voxels = m.octomap(list(b'\0\xc0' + b'\3\0' * 14 + b'\2\0'), 0.1, frame=PANDA.base_frame,
                       origin=m.pose((0.95, -0.05, 0.45)))
    sender.send('monitored_planning_scene', m.scene(
        [box('d', (1.0, 0.0, 0.8), 0.1, 0.1, 0.1)], voxels=voxels))
    bridge.until('3')
    ros.wait_for(lambda: any(marker.ns == '<octomap>' for marker in bridge.markers), 'its cubes')
    cubes = [marker for marker in bridge.markers if marker.ns == '<octomap>'][-1]
    assert cubes.scale.x == 0.1 and cubes.pose.position.x == 0.95
    assert np.allclose([cubes.points[0].x, cubes.points[0].y, cubes.points[0].z], 0.05)


def test_clear_makes_planners_forget_all_other_markers(bridge):
    ros = bridge.ros
    bridge.sender.send('collision_object', box('mine', (1.0, 0.0, 0.0), 0.1, 0.1, 0.1))
    bridge.until('1')
    other = Marker(ns='old', type=Marker.CUBE)
    other.header.frame_id = PANDA.base_frame
    other.pose.position.x = other.scale.x = other.scale.y = other.scale.z = 1.0
    ros.wait_for(ros.obstacles.get_subscription_count, 'a planner')
    ros.obstacles.publish(MarkerArray(markers=[other]))
    bridge.until('2')
    client = ros.node.create_client(Trigger, '/planning_scene_obstacles/clear')
    ros.wait_for(client.service_is_ready, 'the service')
    future = client.call_async(Trigger.Request())
    ros.wait_for(future.done, 'an answer')
    assert future.result().success and future.result().message == '1 objects, 0 attached'
    bridge.until('1')

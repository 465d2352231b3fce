"""Where the objects of a scene are, in frames that the arm has, tf2 has, or nobody has."""

from __future__ import annotations

from types import SimpleNamespace

from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
import numpy as np
import pytest
import rclpy
from rclpy.serialization import deserialize_message
from ros_domains import next_domain
import scene_messages as m
from scene_stand_in import encoded, StandIn
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.errors import ObstacleError
from redundant_planner.nodes import planning_scene_obstacles
from redundant_planner.nodes.joint_messages import JointWriter
from redundant_planner.perception.planning_scene import with_attached, with_object, with_scene

PANDA = make_panda()
# The hand's origin and a point 0.3 m along its x, in the base frame.
PLACES = PANDA.in_base(PANDA_READY, 'panda_hand', np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]]))


class Published:
    """The markers of one topic, by namespace and id, as a planner would keep them."""

    def __init__(self):
        self.markers, self.count = {}, 0

    def publish(self, message):
        self.count += 1
        array = (deserialize_message(message, MarkerArray) if isinstance(message, bytes)
                 else message)
        for marker in array.markers:
            if marker.action == marker.ADD:
                self.markers[marker.ns, marker.id] = marker
            else:
                self.markers.pop((marker.ns, marker.id))

    def place(self, name):
        at = self.markers[name, 0].pose.position
        return self.markers[name, 0].header.frame_id, pytest.approx([at.x, at.y, at.z], abs=1e-9)


@pytest.fixture
def node(monkeypatch, request):
    """A node without an executor: what it publishes and says is kept, time stands still."""
    more = getattr(request, 'param', [])
    rclpy.init(args=['--ros-args', '--params-file', str(ROBOTS / 'panda.yaml'), '-p',
                     f'urdf:={PANDA_URDF}', *more], domain_id=next_domain())
    try:
        made = StandIn()
        made.obstacles, made.held, made.said, made.time = Published(), Published(), [], 100.0
        monkeypatch.setattr(made._markers, '_publisher', made.obstacles)
        monkeypatch.setattr(made._attached, '_publisher', made.held)
        monkeypatch.setattr(made, '_once', made.said.append)
        monkeypatch.setattr(planning_scene_obstacles, 'time',
                            SimpleNamespace(monotonic=lambda: made.time))
        made.states = []
        monkeypatch.setattr(made._joints, 'fetch',
                            lambda: [made.states.pop(0) for _ in range(len(made.states))])
        monkeypatch.setattr(made, '_transform', None)
        yield made
        made.destroy_node()
    finally:
        rclpy.shutdown()


def tell(node, message):
    apply = (with_scene if hasattr(message, 'world') else
             with_attached if hasattr(message, 'link_name') else with_object)
    node._take(apply, encoded(message))


def measure(node):
    node.states.append(JointWriter(PANDA.joint_names).message(1, PANDA_READY, np.zeros(7)))


def ball(name, frame, at=(0.0, 0.0, 0.0), **fields):
    return m.thing(name, at=m.pose(at), frame=frame, primitives=[m.primitive(m.SPHERE, 0.1)],
                   **fields)


def test_an_object_at_a_link_waits_for_joint_states_and_those_behind_it_wait_too(node):
    tell(node, ball('first', 'panda_hand', (0.3, 0.0, 0.0)))
    tell(node, ball('second', 'panda_link0', (1.0, 0.0, 0.0)))
    assert not node.obstacles.markers and not node.said
    measure(node)
    node.time += 0.5
    node._work()
    assert node.obstacles.place('first') == ('panda_link0', PLACES[1].tolist())
    assert node.obstacles.place('second') == ('panda_link0', [1.0, 0.0, 0.0]) and not node.said


def test_an_object_that_is_attached_goes_along_and_is_put_down_where_the_hand_is(node):
    """Attached where the world has it: at the hand's own place in the hand's frame."""
    measure(node)
    tell(node, ball('cup', 'panda_link0', PLACES[1].tolist()))
    tell(node, m.attached('panda_hand', m.thing('cup')))
    assert node.held.place('cup') == ('panda_hand', [0.3, 0.0, 0.0])
    assert not node.obstacles.markers
    turned = PANDA_READY + [0.5, 0, 0, 0, 0, 0, 0]
    node.states.append(JointWriter(PANDA.joint_names).message(1, turned, np.zeros(7)))
    tell(node, m.attached('', m.thing('cup', m.REMOVE)))
    expected = PANDA.in_base(turned, 'panda_hand', np.array([[0.3, 0.0, 0.0]]))[0]
    assert node.obstacles.place('cup') == ('panda_link0', expected.tolist())
    assert not node.held.markers and not node.said


def test_a_frame_of_tf2_is_waited_for_and_given_up_in_the_end(node, monkeypatch):
    known = {}

    def transform(frame):
        if frame not in known:
            raise ObstacleError('tf2 knows no way from there to panda_link0: nothing yet')
        return known[frame]

    monkeypatch.setattr(node, '_transform', transform)
    tell(node, ball('ball', 'world', (0.1, 0.0, 0.0)))
    assert not node.obstacles.markers and not node.said
    known['world'] = np.array([0.0, 0.5, 0.0]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    node._work()
    assert node.obstacles.place('ball') == ('panda_link0', [0.0, 0.6, 0.0])
    tell(node, ball('lost', 'moon'))
    node.time += 2.0
    node._work()
    assert node.said == ["object 'lost' is given in frame 'moon': tf2 knows no way from there to "
                         'panda_link0: nothing yet; ignored']
    assert not node._waiting


def test_without_tf2_an_unknown_frame_is_refused_at_once(node):
    tell(node, ball('ball', 'world'))
    assert node.said == [
        "object 'ball' is given in frame 'world': tf2_ros is not installed, and without it only "
        "'panda_link0' and the arm's own links are known; ignored"]


@pytest.mark.parametrize('node', [['-p', 'base_frame:=world', '-p', 'mount_frame:=world', '-p',
                                   'mount_pose:=[0.0, 0.0, 0.5]']], indirect=True)
def test_a_mounted_arm_knows_the_frame_that_it_stands_in(node):
    tell(node, ball('there', 'world', (1.0, 0.0, 0.0)))
    tell(node, ball('above', 'panda_link0', (1.0, 0.0, 0.0)))
    assert node.obstacles.place('there') == ('world', [1.0, 0.0, 0.0])
    assert node.obstacles.place('above') == ('world', [1.0, 0.0, 0.5]) and not node.said


def test_the_same_again_is_not_published_again(node):
    measure(node)
    tell(node, ball('ball', 'panda_link0', (1.0, 0.0, 0.0)))
    count = node.obstacles.count
    tell(node, ball('ball', 'panda_link0', (1.0, 0.0, 0.0)))
    tell(node, m.scene())
    assert node.obstacles.count == count == 1
    node._look_around()
    assert node.obstacles.count == 2


def test_a_message_that_nobody_foresaw_costs_itself_alone(node):
    tell(node, ball('waits', 'panda_hand'))
    node._take(lambda *arguments: 1 / 0, '{}')
    tell(node, ball('ball', 'panda_link0', (1.0, 0.0, 0.0)))
    measure(node)
    node._work()
    assert {name for name, _ in node.obstacles.markers} == {'waits', 'ball'}
    assert node.guard.count == 1 and 'ZeroDivisionError' in node.guard.last

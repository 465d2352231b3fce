"""The page keeps up with what planners say, however late it looks."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
import time

from conftest import make_paper_arm
from live_helpers import PATIENCE
import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_domains import next_domain
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.io.parameter_files import read_robot_parameters
from redundant_planner.io.parameter_writer import parameter_file_text
from redundant_planner.io.resources import share_directory
from redundant_planner.nodes.messages import markers_of
from redundant_planner.nodes.runtime import best_executor
from redundant_planner.playground.planner_client import PlannerClient

pytestmark = pytest.mark.live
ROBOT = make_paper_arm()
BODY, OBSTACLES = '/right/planner_node/body', '/obstacles'
# As many as a page that has stood still for seconds finds.
MANY = 200


class Heard:
    """A client, and one who publishes what it hears."""

    def __init__(self, context):
        self.node, self.executor = Node('planner', context=context), best_executor(context)
        self.publishers = {topic: self.node.create_publisher(MarkerArray, topic, 2 * MANY)
                           for topic in (BODY, OBSTACLES)}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        file = share_directory() / 'config' / 'robots' / 'paper_2p5r.yaml'
        self.node.create_publisher(String, 'planner_node/configuration', latched).publish(
            String(data=parameter_file_text(
                read_robot_parameters(file)[0], ROBOT, {}, PlannerParameters(),
                replace(PlannerNodeParameters(), obstacle_topics=(OBSTACLES, BODY)))))
        self.client = PlannerClient(self.executor, '', 'planner_node', drives=False)
        self.wait_for(lambda: self.client.robot is not None)
        for publisher in self.publishers.values():
            self.wait_for(lambda p=publisher: p.get_subscription_count() == 1)

    def wait_for(self, condition):
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, self.client.trouble
            self.executor.spin_once(timeout_sec=0.01)

    def publish(self, topic, places):
        for x in places:
            obstacle = Obstacle('thing', (x, 1.0, 1.0), (0.1, 0.1, 0.1))
            self.publishers[topic].publish(markers_of([obstacle], ROBOT.base_frame))
        time.sleep(0.5)

    @property
    def place(self):
        """Where the latest thing is; None while there is none."""
        centers = self.client.scene.centers
        return float(centers[-1, 0]) if len(centers) else None


@contextmanager
def heard():
    context = Context()
    rclpy.init(context=context, domain_id=next_domain())
    try:
        one = Heard(context)
        yield one
        one.client.close()
        one.executor.shutdown()
        one.node.destroy_node()
    finally:
        rclpy.shutdown(context=context)


def test_of_another_arm_it_reads_the_latest_alone(monkeypatch):
    read = []
    update = ObstacleSources.update
    monkeypatch.setattr(ObstacleSources, 'update', lambda self, raw, *rest: (
        read.append(raw), update(self, raw, *rest))[1])
    with heard() as one:
        one.publish(BODY, np.linspace(0.1, 0.9, MANY))
        looks = 0
        while one.place != pytest.approx(0.9):
            one.client.look()
            looks += 1
            assert looks < 100
            time.sleep(0.05)
        assert len(read) <= looks


def test_many_messages_of_obstacles_do_not_hold_up_a_look_and_all_count(monkeypatch):
    read = []
    update = ObstacleSources.update

    def slow(self, raw, *rest):
        time.sleep(0.002)
        read.append(raw)
        return update(self, raw, *rest)

    monkeypatch.setattr(ObstacleSources, 'update', slow)
    with heard() as one:
        one.publish(OBSTACLES, np.linspace(0.1, 0.9, MANY))
        one.client.look()
        assert 1 <= len(read) < MANY // 10
        deadline = time.monotonic() + PATIENCE
        while one.place != pytest.approx(0.9):
            one.client.look()
            assert time.monotonic() < deadline
        # None was left out: the next may be about a thing that only one of them names.
        assert len(read) == MANY

"""Voxels around an arm, as a depth camera's occupancy map sends them, and ticks among them."""

from __future__ import annotations

from collections.abc import Callable
import time

from geometry_msgs.msg import Point
import numpy as np
import numpy.typing as npt
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.shapes import ELLIPSOID
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.obstacle_tracker import ObstacleTracker

Array = npt.NDArray[np.float64]

# Of a voxel, and what they keep off the start posture [m].
_SIZE, _CLEAR = 0.02, 0.05
# Where they lie [m].
_LOW, _HIGH = np.array([-0.8, -0.8, 0.0]), np.array([0.8, 0.8, 1.2])
# The share of them that is another one in the next message, and how many messages there are.
_FLICKER, _FRAMES = 0.05, 12
_CANDIDATES = 5000
# Ticks from one message to the next: 30 Hz at 250 Hz, about.
_EVERY = 8
_DT = 1.0 / 250.0


def voxel_centers(robot: Robot, start: Array, count: int) -> Array:
    """Return centres (k, 3) of cells of a grid that keep off a posture (n,), in any order [m].

    There are a few more than `count`, for messages to choose from.

    Raises:
        ValueError: the grid has fewer cells.
    """
    random = np.random.default_rng(0)
    cells = np.round((_HIGH - _LOW) / _SIZE).astype(int)
    wanted = round(count * (1.0 + _FLICKER)) + 1
    order = random.permutation(int(cells.prod()))
    arm = robot.kinematics(start)
    radii = [capsule.radius + _CLEAR for capsule in robot.capsules]
    found = np.empty((0, 3))
    for first in range(0, len(order), _CANDIDATES):
        index = np.stack(np.unravel_index(order[first:first + _CANDIDATES], cells), axis=-1)
        centers = _LOW + (index + 0.5) * _SIZE
        # The ball around a voxel will do.
        many, resting = len(centers), np.zeros((len(centers), 3))
        balls = Scene(
            ('',) * many, np.full(many, ELLIPSOID), centers, np.tile(np.eye(3), (many, 1, 1)),
            np.full((many, 3), _SIZE), resting, resting)
        pairs = link_clearance(
            inflated_obstacles(balls, radii), arm.segment_start, arm.segment_end)
        found = np.vstack((found, centers[pairs.distance.min(axis=0) > 0.0]))
        if len(found) >= wanted:
            return found[:wanted]
    raise ValueError(f'{count} voxels of {_SIZE} m do not fit around the arm; '
                     f'{len(found)} do')


def voxel_messages(robot: Robot, start: Array, count: int) -> list[bytes]:
    """Return serialised MarkerArrays, each with one CUBE_LIST of `count` voxels."""
    centers, random = voxel_centers(robot, start, count), np.random.default_rng(1)
    messages = []
    for _ in range(_FRAMES):
        marker = Marker(ns='voxels', id=0, type=Marker.CUBE_LIST, action=Marker.ADD)
        marker.header.frame_id = robot.base_frame
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = _SIZE
        marker.color.a = 1.0
        seen = np.sort(random.permutation(len(centers))[:count])
        marker.points = [Point(x=x, y=y, z=z) for x, y, z in centers[seen].tolist()]
        messages.append(bytes(serialize_message(MarkerArray(markers=[marker]))))
    return messages


def voxel_ticks(
    robot: Robot, start: Array, count: int, twist_at: Callable[[int], Array], ticks: int,
) -> dict[str, float]:
    """Return what ticks take while a message comes in every eighth, as in the node [us].

    Between two ticks the node takes a message in and prepares its scene; the next tick finds
    both done.

    Args:
        robot: the arm.
        start: (n,) its posture.
        count: of the voxels.
        twist_at: number of a tick → commanded twist (6,).
        ticks: how many.
    """
    messages = voxel_messages(robot, start, count)
    tracker = ObstacleTracker((), [robot.base_frame])
    planner, q = Planner(robot, PlannerParameters()), start
    steps, intakes, preparations = np.empty(ticks), [], []
    for i in range(ticks):
        begin = time.perf_counter()
        result = planner.step(q, twist_at(i), tracker.scene, _DT)
        steps[i] = time.perf_counter() - begin
        q = q + _DT * result.dq
        if i % _EVERY == 0:
            raw = messages[i // _EVERY % len(messages)]
            begin = time.perf_counter()
            problems = tracker.update(raw, i * _DT)
            taken_in = time.perf_counter()
            planner.prepare(tracker.scene)
            preparations.append(time.perf_counter() - taken_in)
            intakes.append(taken_in - begin)
            if problems or len(tracker.scene.names) != count:
                raise RuntimeError(
                    f'{count} voxels became {len(tracker.scene.names)} obstacles: {problems}')
    # The first message is the only one that comes without anything known.
    return {'voxels': count, 'voxel_step_us': 1e6 * float(np.median(steps)),
            'voxel_step_p99_us': 1e6 * float(np.percentile(steps, 99)),
            'voxel_message_us': 1e6 * float(np.median(intakes)),
            'voxel_prepare_us': 1e6 * float(np.median(preparations)),
            'voxel_longest_us': 1e6 * float(max(
                steps[_EVERY * k] + intakes[k] + preparations[k]
                for k in range(1, len(intakes))))}

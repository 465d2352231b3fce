"""Damaged point clouds: any layout, any numbers, mutated bytes, one after another into one filter.

The voxels must lie within the arm's reach, and there must not be too many.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2, PointField

from benchmark.fuzz.attack_bytes import damaged, NAMES, NUMBERS, paper_arm, Random, START
from benchmark.fuzz.tally import Tally
from redundant_planner.io.cloud_layout import cloud_layout, points_of
from redundant_planner.io.marker_writer import cube_list_bytes
from redundant_planner.io.perception_parameters import CloudParameters
from redundant_planner.perception.cloud_filter import CloudFilter, MOST_VOXELS, SensorPose
from redundant_planner.perception.posture_buffer import Fit, Posture

MESSAGES = 150


def attack(random: Random, folder: Path, tally: Tally) -> None:
    """Show one sequence of damaged clouds to one filter."""
    robot = paper_arm()
    world = CloudFilter(robot, CloudParameters(
        min_points=int(random.integers(1, 3)), persistence=float(random.choice([0.0, 1.0, 1e3])),
        voxel_size=float(random.choice([0.005, 0.025, 1.0]))))
    pose = SensorPose(random.uniform(-2.0, 2.0, 3), np.eye(3), bool(random.integers(2)))

    def see(raw: bytes) -> None:
        layout = cloud_layout(raw)
        posture = Posture(Fit.KNOWN, START, random.uniform(0.0, 9.0, robot.n), 0.0)
        centers = world.see(points_of(raw, layout), pose, posture, 1e-9 * layout.stamp_ns)
        tally.check_finite(centers)
        assert len(centers) <= MOST_VOXELS and (np.diff(world.memory.keys) > 0).all()
        assert (np.linalg.norm(centers, axis=1) < 10.0).all()
        cube_list_bytes('cloud', layout.frame, layout.stamp_ns, 0.025, centers)

    earlier: list[bytes] = [b'']
    for _ in range(MESSAGES):
        raw = bytes(serialize_message(cloud(random)))
        if random.random() < 0.6:
            raw = damaged(random, raw, earlier[int(random.integers(len(earlier)))])
        earlier = [*earlier[-9:], raw]
        tally.attempt(lambda: see(raw))  # noqa: B023


def cloud(random: Random) -> PointCloud2:
    """Return a message of any layout with numbers of any kind."""
    message = PointCloud2(height=int(random.integers(0, 9)), width=int(random.integers(0, 40)),
                          is_bigendian=bool(random.integers(2)))
    message.header.frame_id = str(random.choice(NAMES))
    message.header.stamp.sec = int(random.choice([0, 1, 1000, 2**31 - 1, -5]))
    at, kinds = 0, []
    for name in random.permutation(['x', 'y', 'z', 'rgb']):
        at += int(random.integers(0, 4))
        datatype = int(random.choice([PointField.FLOAT32, PointField.FLOAT64]))
        kind = ('>' if message.is_bigendian else '<') + ('f4' if datatype == 7 else 'f8')
        message.fields.append(PointField(name=str(name), offset=at, datatype=datatype, count=1))
        kinds.append((at, kind))
        at += int(kind[2])
    message.point_step = at + int(random.integers(0, 5))
    message.row_step = message.width * message.point_step + int(random.integers(0, 5))
    data = np.zeros(message.height * message.row_step, np.uint8)
    shape = message.height, message.width
    for offset, kind in kinds if message.width and message.height else ():
        values = random.uniform(-1.0, 1.0, shape)
        odd = random.random(shape) < 0.1
        values[odd] = random.choice(NUMBERS, int(odd.sum()))
        with np.errstate(over='ignore'):
            np.ndarray(shape, kind, data.data, offset, (message.row_step, message.point_step))[
                ...] = values
    message.data = data.tobytes()
    return message

"""Time from the bytes of a point cloud to voxels, on one core.

    python -m benchmark.cloud --points 300000 --json cloud.json

A camera looks at a moving Panda in a room: a table, a shelf, things on them and walls, half of
what it sees within the arm's reach. Each cloud has noise of its own. The time begins with the
message's bytes and ends with those of the markers; `steps_us` says where it goes. The other
layout has big-endian doubles and gaps between points and rows, as no driver would write it; in the
shuffled one the points of an image come in random order, so that no two neighbours share a voxel.
Median and 99th percentile are those of one process; the processor's time leaves out what other
processes took of the core.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from pathlib import Path
import struct
import time
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmark.robots import make_robot
from benchmark.speed import STARTS, versions
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.cloud_layout import cloud_layout, points_of
from redundant_planner.io.cloud_writer import cloud_bytes
from redundant_planner.io.marker_writer import cube_list_bytes
from redundant_planner.io.perception_parameters import CloudParameters
from redundant_planner.perception.cloud_filter import CloudFilter, SensorPose
from redundant_planner.perception.depth_camera import arm_bodies, bodies_of, DepthCamera, together
from redundant_planner.perception.posture_buffer import Fit, Posture

Array = npt.NDArray[np.float64]

LAYOUTS = ('usual', 'other', 'shuffled')
_RATE = 30.0
# Different clouds, shown again and again.
_CLOUDS = 10
_NOISE = 0.003
# x y z in the base frame, and the point that the camera looks at [m].
_CAMERA, _LOOKS_AT = np.array([1.3, 0.5, 1.2]), np.array([0.2, 0.0, 0.4])
_ROOM = (
    Obstacle.box('table', (0.55, 0.0, -0.02), (0.7, 1.8, 0.04)),
    Obstacle.box('back of the shelf', (0.0, 0.75, 0.5), (0.8, 0.04, 1.0)),
    Obstacle.box('shelf', (0.0, 0.65, 0.6), (0.8, 0.2, 0.02)),
    Obstacle.box('panel', (-0.9, 0.0, 0.6), (0.04, 3.0, 2.4)),
    Obstacle.box('floor', (0.0, 0.0, -0.8), (8.0, 8.0, 0.04)),
    Obstacle.box('wall', (0.0, -1.8, 0.5), (8.0, 0.04, 4.0)),
    Obstacle.cylinder('can', (0.5, -0.35, 0.1), 0.05, 0.2),
    Obstacle('ball', (0.6, 0.25, 0.08), (0.08, 0.08, 0.08)),
    Obstacle.box('carton', (0.4, 0.5, 0.1), (0.2, 0.12, 0.2)))


def main(args: list[str] | None = None) -> int:
    """Run the benchmark; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='benchmark.cloud', description=__doc__)
    parser.add_argument('--points', type=int, default=300_000)
    parser.add_argument('--clouds', type=int, default=300, help='how many are timed')
    parser.add_argument('--voxel-size', type=float, default=CloudParameters().voxel_size)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args(args)
    # One core, whichever is free.
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    result: dict[str, Any] = {'points': options.points, 'versions': versions()}
    for layout in LAYOUTS:
        result[layout] = measure(
            options.points, options.clouds, CloudParameters(voxel_size=options.voxel_size), layout)
    show(result)
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1))
    return 0


def measure(points: int, clouds: int, parameters: CloudParameters, layout: str) -> dict[str, Any]:
    """Return the times of some clouds; keys as in the JSON."""
    robot = make_robot('panda', 6)
    pose, messages, postures = views(robot, points)
    if layout == 'other':
        messages = [awkward(raw) for raw in messages]
    if layout == 'shuffled':
        messages = [shuffled(raw) for raw in messages]
    world, room = CloudFilter(robot, parameters), np.empty((3, points))
    total, work, steps = np.empty(clouds), np.empty(clouds), []
    voxels = 0
    for i in track(range(clouds), description=f'{layout} layout'):
        raw, stamp = messages[i % _CLOUDS], i / _RATE
        begin_work, begin = time.thread_time(), time.perf_counter()
        found = cloud_layout(raw)
        seen = points_of(raw, found, room)
        parsed = time.perf_counter()
        centers = world.see(seen, pose, postures[i % _CLOUDS], stamp)
        filtered = time.perf_counter()
        cube_list_bytes('cloud', robot.base_frame, found.stamp_ns, parameters.voxel_size, centers)
        end = time.perf_counter()
        total[i], work[i] = end - begin, time.thread_time() - begin_work
        steps.append({'parse': parsed - begin, **world.times,
                      'rest': filtered - parsed - sum(world.times.values()),
                      'message': end - filtered})
        voxels = max(voxels, len(centers))
    return {
        'median_ms': 1e3 * float(np.median(total)),
        'p99_ms': 1e3 * float(np.percentile(total, 99)),
        'longest_ms': 1e3 * float(total.max()),
        'processor_median_ms': 1e3 * float(np.median(work)),
        'processor_p99_ms': 1e3 * float(np.percentile(work, 99)),
        'voxels': voxels, 'bytes': len(messages[0]),
        'steps_us': {name: 1e6 * float(np.median([step[name] for step in steps]))
                     for name in steps[0]}}


def views(robot: Robot, points: int) -> tuple[SensorPose, list[bytes], list[Posture]]:
    """Return the camera's pose, and messages and postures as the arm moves to and fro."""
    height = max(int(math.sqrt(0.75 * points)), 1)
    while points % height:
        height -= 1
    camera = DepthCamera(points // height, height, 1.2, 10.0, _NOISE)
    ahead = (_LOOKS_AT - _CAMERA) / np.linalg.norm(_LOOKS_AT - _CAMERA)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.column_stack([right, np.cross(ahead, right), ahead])
    room = bodies_of(Scene.of(_ROOM))
    random, messages, postures = np.random.default_rng(0), [], []
    radii = np.array([capsule.radius for capsule in robot.capsules])
    speed = np.full(robot.n, 0.5)
    for i in range(_CLOUDS):
        q = STARTS['panda'] + 0.5 * np.sin(2.0 * np.pi * i / _CLOUDS)
        arm = robot.kinematics(q)
        bodies = together(arm_bodies(arm.segment_start, arm.segment_end, radii), room)
        messages.append(cloud_bytes(camera.points(_CAMERA, axes, bodies, random), 'camera', 10**9))
        postures.append(Posture(Fit.KNOWN, q, speed, 0.0))
    return SensorPose(_CAMERA, axes, True), messages, postures


def awkward(raw: bytes) -> bytes:
    """Return a cloud with the same points: big-endian doubles at odd offsets, gaps in between."""
    layout = cloud_layout(raw)
    points = points_of(raw, layout)
    step = 37
    row = layout.width * step + 11
    data = np.zeros(layout.height * row, np.uint8)
    for axis, offset in enumerate((17, 1, 29)):
        np.ndarray((layout.height, layout.width), '>f8', data.data, offset, (row, step))[...] = (
            points[axis].reshape(layout.height, layout.width))
    name = layout.frame.encode()
    head = struct.pack(f'<4siII{len(name)}sx', b'\0\1\0\0', 1, 0, len(name) + 1, name)
    head += bytes(-len(head) % 4) + struct.pack('<3I', layout.height, layout.width, 3)
    for letter, offset in zip(b'xyz', (17, 1, 29)):
        head += struct.pack('<IBB2xIB3xI', 2, letter, 0, offset, 8, 1)
    return head + struct.pack('<B3x3I', 1, step, row, len(data)) + data.tobytes() + b'\0'


def shuffled(raw: bytes) -> bytes:
    """Return a cloud with the same points in random order."""
    layout = cloud_layout(raw)
    points = np.random.default_rng(0).permutation(points_of(raw, layout).T)
    return cloud_bytes(points[None], layout.frame, layout.stamp_ns)


def show(result: dict[str, Any]) -> None:
    """Print the figures."""
    table = Table(title=f'{result["points"]} points to voxels, on one core')
    table.add_column('')
    for layout in LAYOUTS:
        table.add_column(f'{layout} layout', justify='right')
    for name, unit in (('median_ms', 'ms'), ('p99_ms', 'ms'), ('longest_ms', 'ms'),
                       ('processor_median_ms', 'ms'), ('processor_p99_ms', 'ms'),
                       ('voxels', ''), ('bytes', '')):
        table.add_row(name, *(f'{result[layout][name]:.4g} {unit}' for layout in LAYOUTS))
    for step in result['usual']['steps_us']:
        table.add_row(f'  {step}', *(
            f'{result[layout]["steps_us"][step] / 1e3:.2f} ms, '
            f'{0.1 * result[layout]["steps_us"][step] / result[layout]["median_ms"]:.0f} %'
            for layout in LAYOUTS))
    Console(width=100).print(table)


if __name__ == '__main__':
    raise SystemExit(main())

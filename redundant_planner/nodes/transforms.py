"""Looks other frames up in tf2, if it is installed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rclpy.node import Node
from rclpy.time import Time

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles.scene import rotations
from redundant_planner.io.obstacle_tracker import Transform


def transform_lookup(node: Node, base_frame: str) -> Callable[..., Transform] | None:
    """Return a function from frame names to transforms; None if tf2_ros is not installed.

    Its second argument is the moment [ns]; left out or 0, the latest transform counts. The node
    listens to /tf only from the first look-up on, as listening costs time.
    """
    try:
        import tf2_ros
    except ImportError:
        return None
    buffers: list[tf2_ros.Buffer] = []
    listeners = []

    def transform(frame: str, stamp_ns: int = 0) -> Transform:
        if not buffers:
            buffers.append(tf2_ros.Buffer())
            listeners.append(tf2_ros.TransformListener(buffers[0], node))
        try:
            found = buffers[0].lookup_transform(
                base_frame, frame, Time(nanoseconds=stamp_ns)).transform
        except tf2_ros.TransformException as error:
            raise ObstacleError(f'tf2 knows no way from there to {base_frame}: {error}') from None
        p, o = found.translation, found.rotation
        return np.array([p.x, p.y, p.z]), rotations(np.array([[o.x, o.y, o.z, o.w]]))[0]

    return transform

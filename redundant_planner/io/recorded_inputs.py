"""Single inputs of a planner as they stand in a bag."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from redundant_planner.io.bag_reader import Event
from redundant_planner.io.left_out import LeftOut
from redundant_planner.io.obstacle_tracker import Transform
from redundant_planner.io.plausible import LARGEST

Array = npt.NDArray[np.float64]


def as_it_is(frame: str) -> Transform:
    """Take every frame for the base's: what a planner refused is not known from a bag."""
    return np.zeros(3), np.eye(3)


def sound_twist(item: Event, left_out: LeftOut) -> Array | None:
    """Return the six numbers of a cmd_vel, None where the node does not take them either."""
    twist = twist_of(item.message)
    if (np.abs(twist) <= LARGEST).all():
        return twist
    left_out.add(item.topic, f'they have numbers that are not finite, or beyond {LARGEST:g}')
    return None


def twist_of(message: Any) -> Array:
    """Return the six numbers of a decoded Twist or TwistStamped."""
    twist = getattr(message, 'twist', message)
    linear, angular = twist.linear, twist.angular
    return np.array([linear.x, linear.y, linear.z, angular.x, angular.y, angular.z])

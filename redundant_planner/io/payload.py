"""What the hand holds, by the markers on `attached`."""

from __future__ import annotations

import numpy as np

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.obstacle_tracker import ObstacleTracker, Transform


class Payload:
    """Markers in the tip's frame, or in that of another link that moves along with it.

    Attributes:
        tracker: takes the messages.
    """

    def __init__(self, robot: Robot) -> None:
        """Begin with an empty hand of a robot."""
        def in_tip_frame(frame: str) -> Transform:
            if frame not in robot.links_of_tip:
                raise ObstacleError(f"it must be in '{robot.tip_frame}', or the frame of a link "
                                    'that is fixed to it')
            corners = robot.in_link(robot.tip_frame, frame, np.vstack((np.zeros(3), np.eye(3))))
            return corners[0], (corners[1:] - corners[0]).T

        self.tracker = ObstacleTracker((), (robot.tip_frame, ''), transform=in_tip_frame)
        self._scene = self.tracker.scene

    def changed(self) -> tuple[Obstacle, ...] | None:
        """Return all that is held, in the tip's frame; None if it was so at the last call."""
        if self.tracker.scene is self._scene:
            return None
        self._scene = self.tracker.scene
        return self._scene.obstacles()

    @property
    def names(self) -> frozenset[str]:
        """What is held, by the names that markers have as obstacles."""
        return frozenset(self.tracker.scene.names)

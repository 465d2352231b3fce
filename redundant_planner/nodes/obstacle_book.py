"""The obstacles a node knows of: those of its parameters and those that markers brought."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles import Obstacle, Scene
from redundant_planner.nodes.messages import NANOSECONDS, obstacle_from_marker, obstacle_key


class ObstacleBook:
    """Static obstacles and markers with their lifetimes, as one scene.

    `scene` stays the same object while nothing changes.
    """

    def __init__(self, static: Iterable[Obstacle], frames: Sequence[str]) -> None:
        """Begin with the static obstacles.

        Args:
            static: obstacles that no marker removes.
            frames: names the base frame goes by in markers.
        """
        self._static = tuple(static)
        self._frames = tuple(frames)
        self._live: dict[tuple[str, int], Obstacle] = {}
        self._expiry: dict[tuple[str, int], float] = {}
        self.scene = Scene.of(self._static)

    def update(self, message: MarkerArray, now: float) -> list[str]:
        """Apply a message at time `now` [s]; return what was wrong, one sentence per marker.

        A marker that cannot be used changes nothing: the obstacle of that name stays as it was.
        """
        problems = []
        for marker in message.markers:
            key = (marker.ns, marker.id)
            if marker.action == Marker.DELETEALL:
                self._live.clear()
                self._expiry.clear()
            elif marker.action == Marker.DELETE:
                self._live.pop(key, None)
                self._expiry.pop(key, None)
            elif marker.action == Marker.ADD:  # MODIFY is the same number
                try:
                    self._live[key] = obstacle_from_marker(marker, self._frames)
                except ObstacleError as error:
                    problems.append(str(error))
                    continue
                lifetime = marker.lifetime.sec + marker.lifetime.nanosec / NANOSECONDS
                if lifetime > 0.0:
                    self._expiry[key] = now + lifetime
                else:
                    self._expiry.pop(key, None)
            else:
                problems.append(f"obstacle '{obstacle_key(marker)}' has action "
                                f'{marker.action}; it must be ADD, DELETE or DELETEALL')
        self._rebuild()
        return problems

    def expire(self, now: float) -> None:
        """Remove the obstacles whose lifetime has ended by `now` [s]."""
        ended = [key for key, end in self._expiry.items() if now >= end]
        for key in ended:
            del self._live[key], self._expiry[key]
        if ended:
            self._rebuild()

    def _rebuild(self) -> None:
        self.scene = Scene.of((*self._static, *self._live.values()))

"""Obstacles from several topics as one scene."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import joined, Scene
from redundant_planner.io.obstacle_tracker import ObstacleTracker, Transform


class ObstacleSources:
    """One tracker for each topic: a name, or a DELETEALL, of one means nothing on another."""

    def __init__(self, trackers: Sequence[ObstacleTracker]) -> None:
        """Begin with a tracker for each topic, one at least."""
        self._trackers = tuple(trackers)
        self._parts: tuple[Scene, ...] = ()
        self._scene = Scene.of()

    @classmethod
    def of(
        cls, topics: int, static: Iterable[Obstacle], frames: Sequence[str], *,
        transform: Callable[[str], Transform] | None, estimate_velocity: bool,
    ) -> ObstacleSources:
        """Begin with the static obstacles and so many topics, as `ObstacleTracker` does."""
        return cls([ObstacleTracker(
            () if i else static, frames, transform=transform, estimate_velocity=estimate_velocity)
            for i in range(topics)])

    @property
    def scene(self) -> Scene:
        """All obstacles; the same object while nothing changes."""
        parts = tuple(tracker.scene for tracker in self._trackers)
        if len(parts) == 1:
            return parts[0]
        if len(parts) != len(self._parts) or any(
                one is not other for one, other in zip(parts, self._parts)):
            self._parts, self._scene = parts, joined(parts)
        return self._scene

    def update(self, raw: bytes, now: float, topic: int = 0) -> list[str]:
        """Apply a serialised MarkerArray of a topic at time `now` [s]; return its problems."""
        return self._trackers[topic].update(raw, now)

    def refused(self, topic: int) -> bool:
        """Return whether nothing of a topic's latest message could be used."""
        return self._trackers[topic].refused

    def expire(self, now: float) -> None:
        """Remove the obstacles whose lifetime has ended by `now`, and stop silent ones [s]."""
        for tracker in self._trackers:
            tracker.expire(now)

    @property
    def hidden(self) -> frozenset[str]:
        """Names of obstacles from markers that are none for the time being."""
        return self._trackers[0].hidden

    @hidden.setter
    def hidden(self, names: frozenset[str]) -> None:
        for tracker in self._trackers:
            tracker.hidden = names

    def keep(self, static: Iterable[Obstacle], *, estimate_velocity: bool) -> None:
        """Replace the static obstacles, and whether velocities are estimated.

        Raises:
            ObstacleError: see `ObstacleTracker`; nothing has changed then.
        """
        self._trackers[0].static = static
        for tracker in self._trackers:
            tracker.estimate_velocity = estimate_velocity

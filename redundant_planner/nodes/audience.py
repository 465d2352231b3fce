"""Notices outputs that nobody hears: a command that no controller takes moves no arm."""

from __future__ import annotations

from collections.abc import Mapping

from redundant_planner.io.node_parameters import JOINT_COMMAND

# How long after the first motion an output may be without a listener: nodes find each other [s].
FOUND_WITHIN = 2.0


class Audience:
    """Knows which outputs should have listeners, and which ones had some."""

    def __init__(self, topics: Mapping[str, str]) -> None:
        """Begin before the first motion.

        Args:
            topics: output → topic that it is published on, of those that move the arm.
        """
        self._topics = topics
        self._heard: set[str] = set()

    def missing(self, listeners: Mapping[str, int], moving_for: float) -> str:
        """Return the sentence about outputs that nobody hears; empty if there are none.

        Args:
            listeners: output → their number.
            moving_for: how long ago the first motion was wanted, negative before [s].
        """
        if moving_for < 0.0:
            return ''
        self._heard.update(name for name in self._topics if listeners[name])
        return '; '.join(
            self._sentence(name) for name in self._topics
            if not listeners[name] and (name in self._heard or moving_for >= FOUND_WITHIN))

    def _sentence(self, name: str) -> str:
        listener = 'driver' if name == JOINT_COMMAND else 'controller'
        left = ' any more' if name in self._heard else ''
        return (f'nobody listens to {name} on {self._topics[name]}{left}: load the {listener}, '
                f"or remap {name} to the {listener}'s topic")

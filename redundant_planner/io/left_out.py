"""Counts messages that could not be used, so that the user reads how many and why."""

from __future__ import annotations

from collections import Counter

# Reasons for leaving messages of a topic out that are spelt out.
_REASONS = 3


class LeftOut:
    """Messages that could not be used: how many on which topic, and why."""

    def __init__(self) -> None:
        """Begin without any."""
        self._counts: dict[str, Counter[str]] = {}

    def add(self, topic: str, reason: str, count: int = 1) -> None:
        """Count messages; the first few reasons of a topic are kept."""
        reasons = self._counts.setdefault(topic, Counter())
        known_one = reason in reasons or len(reasons) < _REASONS
        reasons[reason if known_one else 'other reasons'] += count

    def sentences(self) -> list[str]:
        """Return a sentence per topic and reason."""
        return [f'{count} messages on {topic} are left out: {reason}'
                for topic, reasons in self._counts.items()
                for reason, count in reasons.items() if count]

"""What the planner said of itself in `/diagnostics`."""

from __future__ import annotations

from dataclasses import dataclass, field
import re
from typing import Any

import numpy as np
import numpy.typing as npt

from redundant_planner.io.bag_reader import Event

Array = npt.NDArray[np.float64]

# DiagnosticStatus.ERROR.
_ERROR = 2
# Kinds of errors that are told apart.
_MOST_KINDS = 20
# Times at which the planner said something else than before.
_MOST_WORDS = 100_000
# How far apart in time a word of the planner's and what it explains may be [s].
_WORD = 0.3
# Ages and distances that one error says differently each time.
_NUMBER = re.compile(r'\d+(\.\d+)?')


@dataclass
class PlannerReports:
    """The numbers of the planner's status, collected message by message.

    Attributes:
        factors: time and k of Eq. 2 of every status.
        medians, longest: of the ticks since the status before [s].
        errors: kind of an error → when it was first and last reported [s], and its sentence.
        of_target, of_itself: what the planner complains of, on `~/target` and in `/diagnostics`:
            from when on [s], and the words, empty for nothing.
    """

    factors: list[tuple[float, float]] = field(default_factory=list)
    medians: list[float] = field(default_factory=list)
    longest: list[float] = field(default_factory=list)
    errors: dict[str, tuple[float, float, str]] = field(default_factory=dict)
    of_target: list[tuple[float, str]] = field(default_factory=list)
    of_itself: list[tuple[float, str]] = field(default_factory=list)

    def add(self, event: Event) -> None:
        """Take in a DiagnosticArray; entries that are no numbers are left out."""
        for status in event.message.status:
            self._note_error(status, event.arrival)
            if status.name.endswith(': planner'):
                _note(self.of_itself, event.arrival, status.message if status.level else '')
            for entry in status.values:
                number = _number(entry)
                if number is None:
                    continue
                if entry.key == 'factor k':
                    self.factors.append((event.arrival, number))
                elif entry.key == 'tick time, median [us]':
                    self.medians.append(1e-6 * number)
                elif entry.key == 'tick time, longest [us]':
                    self.longest.append(1e-6 * number)

    def add_target(self, event: Event) -> bool:
        """Take in a DiagnosticArray of `~/target`; return whether there is a target."""
        there = False
        for status in event.message.status:
            values = {entry.key: entry.value for entry in status.values}
            if 'limited by' in values:
                there = True
                _note(self.of_target, event.arrival, values['limited by'])
        return there

    def word_at(self, time: float) -> str:
        """Return what the planner complained of at about a time [s], empty for nothing."""
        return _word_at(self.of_target, time) or _word_at(self.of_itself, time)

    def _note_error(self, status: Any, time: float) -> None:
        """Remember an error of the planner's; others publish on this topic, too."""
        if status.level != _ERROR or not status.name.endswith(': planner'):
            return
        kind = _NUMBER.sub('#', status.message)
        if kind in self.errors or len(self.errors) < _MOST_KINDS:
            first, _, sentence = self.errors.get(kind, (time, time, status.message))
            self.errors[kind] = first, time, sentence

    @property
    def notes(self) -> list[str]:
        """A sentence for each kind of error that was reported."""
        return [f'from {first:.1f} to {last:.1f} s the planner reported an error: {sentence}'
                for first, last, sentence in self.errors.values()]

    @property
    def factor(self) -> Array:
        """Times and k, (k, 2)."""
        return np.array(self.factors).reshape(-1, 2)

    @property
    def tick_median(self) -> float | None:
        """The median of the reported medians [s], None without any."""
        return float(np.median(self.medians)) if self.medians else None

    @property
    def tick_longest(self) -> float | None:
        """The longest tick [s], None if none was reported."""
        return max(self.longest, default=None)


def _note(words: list[tuple[float, str]], time: float, word: str) -> None:
    """Note what is said at a time [s], if it is something else than before."""
    if (words[-1][1] if words else '') != word and len(words) < _MOST_WORDS:
        words.append((time, word))


def _word_at(words: list[tuple[float, str]], time: float) -> str:
    """Return what was complained of at about a time [s], the latest of it."""
    found = ''
    for begin, word in words:
        if begin > time + _WORD:
            break
        # What ended just before counts too: the arm lags behind what is decided.
        if word or begin <= time - _WORD:
            found = word
    return found


def _number(entry: Any) -> float | None:
    try:
        value = float(entry.value)
    except ValueError:
        return None
    return value if np.isfinite(value) else None

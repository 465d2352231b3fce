"""Errors raised while something is constructed; the control loop itself never raises."""

from __future__ import annotations

from collections.abc import Iterable
import difflib


class PlannerError(ValueError):
    """Base of every error this package raises on bad input.

    The message names the thing, the value it had and what would have been right.
    """


class RobotError(PlannerError):
    """The robot description cannot be used as asked."""


class ObstacleError(PlannerError):
    """An obstacle or capsule is not a valid shape."""


class ParameterError(PlannerError):
    """A parameter has the wrong type, length or range."""


class StateError(PlannerError):
    """A joint state, posture or twist does not fit the robot."""


class ScenarioError(PlannerError):
    """A scenario file cannot be used."""


def known(names: Iterable[str]) -> str:
    """Return the names as a short list for the end of a message."""
    names = list(names)
    shown = ', '.join(f"'{name}'" for name in names[:12])
    return f'{shown} and {len(names) - 12} more' if len(names) > 12 else shown or 'none'


def unknown_names(given: Iterable[str], known: Iterable[str]) -> list[str]:
    """Return a sentence for every given parameter name that is not known.

    It says which known name was probably meant, if one is near.
    """
    known = sorted(set(known))
    sentences = []
    for name in sorted(set(given) - set(known)):
        near = difflib.get_close_matches(name, known, 1)
        meant = f"; did you mean '{near[0]}'?" if near else ''
        sentences.append(f"parameter '{name}' is not known{meant}")
    return sentences


def shown(value: object) -> str:
    """Return a value as a message shows it, not longer than a line."""
    text = repr(value)
    return text if len(text) <= 80 else f'{text[:77]}...'

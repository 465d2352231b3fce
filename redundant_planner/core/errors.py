"""Errors raised while something is constructed; the control loop itself never raises."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
import reprlib
from typing import Any

# Messages list no more names than this, and no more characters of each.
_LISTED = 12
_LONGEST_NAME = 100


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
    listed = ', '.join(f"'{str(name)[:_LONGEST_NAME]}'" for name in names[:_LISTED])
    more = len(names) - _LISTED
    return f'{listed} and {more} more' if more > 0 else listed or 'none'


def shown(value: Any) -> str:
    """Return a value as it would be written in Python, but no longer than a message may be."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = short.maxlong = 80
    short.maxlevel = 3
    try:
        return short.repr(value)
    except ValueError:  # a whole number with more digits than Python likes to write
        return f'a very large {type(value).__name__}'


def unknown_names(given: Iterable[str], known: Iterable[str]) -> list[str]:
    """Return a sentence about every given parameter name that is not a known one.

    Each suggests the known name that was probably meant.
    """
    candidates = list(known)
    unknown = sorted(set(map(str, given)) - set(candidates))
    sentences = []
    for name in unknown[:_LISTED]:
        near = get_close_matches(name, candidates, n=1) if len(name) <= _LONGEST_NAME else []
        suggestion = f"; did you mean '{near[0]}'?" if near else ''
        sentences.append(f"parameter '{name[:_LONGEST_NAME]}' is not known{suggestion}")
    if len(unknown) > _LISTED:
        sentences.append(f'{len(unknown) - _LISTED} more parameters are not known')
    return sentences

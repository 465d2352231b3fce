"""A planner's configuration as it stands in a bag, where it may be anything."""

from __future__ import annotations

import math
from typing import Any

import yaml

from redundant_planner.core.errors import PlannerError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.workspace import walls
from redundant_planner.io.obstacle_entries import static_obstacles
from redundant_planner.io.parameter_files import flat, parameter_values

# A configuration with its URDF has 0.1 MB, some thousand values and a depth of 5.
_LONGEST = 2_000_000
_VALUES = 200_000
_DEPTH = 20
# A command holds for this long if the bag does not say how long [s].
COMMAND_TIMEOUT = 0.1


def configuration_of(text: str, notes: list[str]) -> dict[str, Any]:
    """Return the parameter values of a recorded configuration; none if it is unusable.

    Args:
        text: as recorded.
        notes: takes a sentence about what is wrong.
    """
    try:
        if len(text) > _LONGEST:
            raise PlannerError(f'it has {len(text)} characters; {_LONGEST} at most are read')
        content = yaml.safe_load(text)
        _check_size(content)
        values = parameter_values(content, 'it')
        if not all(isinstance(name, str) for name in values):
            raise PlannerError('a parameter has no name')
        return flat(values)
    # PyYAML raises more than its own errors: a ValueError of a date, a RecursionError.
    except (yaml.YAMLError, ValueError, TypeError, ArithmeticError, RecursionError) as error:
        notes.append(f'the recorded configuration is unusable: {error}')
        return {}


def _check_size(content: Any) -> None:
    """Count the values, each alias for all that it stands for.

    Raises:
        PlannerError: there are too many, or they are nested too deeply.
    """
    count, stack = 0, [(content, 0)]
    while stack:
        value, depth = stack.pop()
        count += 1
        if count > _VALUES or depth > _DEPTH:
            raise PlannerError(f'it has more than {_VALUES} values, or more than {_DEPTH} in one '
                               'another')
        if isinstance(value, dict):
            stack += [(item, depth + 1) for item in (*value, *value.values())]
        elif isinstance(value, (list, tuple, set)):
            stack += [(item, depth + 1) for item in value]


def number_of(values: dict[str, Any], name: str, default: float, highest: float) -> float:
    """Return a recorded parameter, the default where it is no number in 0 < number ≤ highest."""
    value = values.get(name, default)
    sound = (isinstance(value, (int, float)) and not isinstance(value, bool)
             and 0.0 < value <= highest and math.isfinite(value))
    return float(value) if sound else default


def obstacle_topics(values: dict[str, Any]) -> list[str]:
    """Return the names of the topics with obstacles, without a slash before them."""
    given = values.get('obstacle_topics')
    named = isinstance(given, list) and given and all(
        isinstance(name, str) and name.strip('/') for name in given)
    return [name.strip('/') for name in given] if named and given else ['obstacles']


def recorded_obstacles(values: dict[str, Any], notes: list[str]) -> list[Obstacle]:
    """Return the static obstacles of a recorded configuration; none if they are unusable."""
    try:
        return static_obstacles(values)
    except Exception as error:  # a bag may hold anything, and is analysed all the same
        notes.append(f'the static obstacles of the recorded configuration are unusable: {error}')
        return []


def recorded_walls(values: dict[str, Any], notes: list[str]) -> list[Obstacle]:
    """Return the walls of a recorded configuration's workspace; none if they are unusable."""
    try:
        return list(walls([float(number) for number in values.get('workspace', ())]))
    except Exception as error:  # as above
        notes.append(f'the workspace of the recorded configuration is unusable: {error}')
        return []

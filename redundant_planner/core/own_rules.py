"""Rules of the user's own: barriers that the filter keeps, and criteria of Eq. 18.

A rule is a function of the arm's kinematics that returns a number and its gradient. It is held
against finite differences when it is given, and called in each tick from then on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ParameterError, shown
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]
Rule = Callable[[Kinematics], tuple[float, npt.ArrayLike]]

# At how many random postures a gradient is looked at, by differences over such steps [rad, m]. It
# may be off by this share of its largest entry.
_POSTURES, _STEP, _OFF = 8, 1e-5, 1e-3
# Joints without limits are looked at within this of 0 [rad, m].
_NO_LIMIT = math.pi


@dataclass(frozen=True)
class Barrier:
    """What the filter keeps at 0 or more.

    Attributes:
        name: how reasons and errors call it.
        function: takes the arm's `Kinematics`, returns h and ∇h: a number, 0 or more where the
            arm may be, in any unit, and its derivatives (n,) by the joint positions.
    """

    name: str
    function: Rule


@dataclass(frozen=True)
class Criterion:
    """What null-space motion makes larger: a term of ∇H in Eq. 18.

    Attributes:
        name: how errors call it.
        function: takes the arm's `Kinematics`, returns H and ∇H: a number, and its derivatives
            (n,) by the joint positions. The negative of what shall become smaller.
        weight: what it counts, 0 or more.
    """

    name: str
    function: Rule
    weight: float = 1.0


class Measured(NamedTuple):
    """What a rule's function returns: its value, and its gradient (n,)."""

    value: float
    gradient: Array


def measured(rule: Barrier | Criterion, arm: Kinematics) -> Measured | None:
    """Return a rule's value and gradient at a posture; None unless they are finite numbers."""
    value, gradient = rule.function(arm)
    found = Measured(float(value), np.array(gradient, dtype=float))
    if found.gradient.shape != arm.q.shape or not (
            math.isfinite(found.value) and np.isfinite(found.gradient).all()):
        return None
    return found


def checked_rules(
    robot: Robot, barriers: Sequence[Barrier], criteria: Sequence[Criterion],
) -> list[float]:
    """Return how large each rule's gradient is in the median of some postures [unit per rad, m].

    Raises:
        ParameterError: names are not unique, a weight is no number of 0 or more, a function does
            not return what it has to, or a gradient is not that of its value.
    """
    sizes, seen = [], set()
    for kind, rules in ((Barrier, barriers), (Criterion, criteria)):
        for rule in rules:
            what = kind.__name__.lower()
            if not isinstance(rule, kind):
                raise ParameterError(f'{what} is {shown(rule)}; it takes a {kind.__name__}')
            if not isinstance(rule.name, str) or not rule.name or rule.name in seen:
                raise ParameterError(f'a {what} is named {shown(rule.name)}; it takes a name of '
                                     'its own, which is not empty')
            if isinstance(rule, Criterion) and not 0.0 <= rule.weight < math.inf:
                raise ParameterError(f"criterion '{rule.name}' has the weight "
                                     f'{shown(rule.weight)}; it takes a number of 0 or more')
            seen.add(rule.name)
            sizes.append(_size(robot, rule, f"{what} '{rule.name}'"))
    return sizes


def _size(robot: Robot, rule: Barrier | Criterion, name: str) -> float:
    """Hold a rule's gradient against differences; return how large it is in the median."""
    random = np.random.default_rng(0)
    low = np.where(np.isfinite(robot.position_min), robot.position_min, -_NO_LIMIT)
    high = np.where(np.isfinite(robot.position_max), robot.position_max, _NO_LIMIT)
    postures = random.uniform(low, high, (_POSTURES, robot.n))
    said, found = np.empty((2, _POSTURES, robot.n))
    for q, gradient, differences in zip(postures, said, found):
        gradient[:] = _asked(robot, rule, name, q).gradient
        for j in range(robot.n):
            step = np.zeros(robot.n)
            step[j] = _STEP
            differences[j] = (_asked(robot, rule, name, q + step).value
                              - _asked(robot, rule, name, q - step).value) / (2.0 * _STEP)
    off = np.abs(said - found)
    i, j = divmod(int(off.argmax()), robot.n)
    if off[i, j] > _OFF * max(np.abs(said).max(), np.abs(found).max()):
        raise ParameterError(
            f"{name}: its gradient has {said[i, j]:.6g} for joint '{robot.joint_names[j]}', but "
            f'its value changes by {found[i, j]:.6g} for each rad or m of it, at the posture '
            f'{shown(np.round(postures[i], 4).tolist())}; it takes the derivative of the value by '
            'each joint position')
    return float(np.median(np.linalg.norm(said, axis=1)))


def _asked(robot: Robot, rule: Barrier | Criterion, name: str, q: Array) -> Measured:
    """Return what a rule says at a posture (n,).

    Raises:
        ParameterError: that is not a finite number and n of them.
    """
    at, takes = f'at the posture {shown(np.round(q, 4).tolist())}', (
        f'it returns a number and its gradient, {robot.n} numbers, one for each joint of '
        f"'{robot.name}'")
    try:
        answer = rule.function(robot.kinematics(q))
    except Exception as error:
        raise ParameterError(
            f'{name} raised {type(error).__name__} {at}: {error}; {takes}') from error
    try:
        value, gradient = answer
        value, gradient = float(value), np.array(gradient, dtype=float)
    except (TypeError, ValueError) as error:
        raise ParameterError(f'{name} returned {shown(answer)} {at}; {takes}') from error
    if gradient.shape != (robot.n,):
        raise ParameterError(
            f'{name} returned a gradient of the shape {gradient.shape} {at}; {takes}')
    if not math.isfinite(value):
        raise ParameterError(f'{name} is {value} {at}; {takes}, all of them finite')
    if not np.isfinite(gradient).all():
        k = int(np.argmin(np.isfinite(gradient)))
        raise ParameterError(
            f"{name}: its gradient has {gradient[k]} for joint '{robot.joint_names[k]}' {at}; "
            f'{takes}, all of them finite')
    return Measured(value, gradient)

"""What the joints of a chain may do and how unwilling they are, and where each limit is from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, RobotError, shown
from redundant_planner.core.numbers import floats_of
from redundant_planner.core.robot.urdf import Joint, LARGEST

Array = npt.NDArray[np.float64]
Values = Sequence[float] | float | Array
# Joint name → its lowest and highest position [rad, m].
Ranges = Mapping[str, tuple[float, float]]

# Where a limit is from.
URDF, PARAMETER, DEFAULT = 'URDF', 'parameter', 'default'

# Taken where nobody gives an acceleration limit [rad/s², m/s²].
ACCELERATION = 5.0
# Jerk limits where none are given, as a multiple of the acceleration limits [1/s]: MoveIt's for
# joints of unknown limits, 1000 rad/s³ beside 10 rad/s².
_JERK = 100.0
# How long a joint may need to turn its acceleration round at most [s].
_LONGEST_RAMP = 1.0
# The planner's arithmetic keeps its digits within these [rad/s, m/s; per s²].
_SLOWEST, _FASTEST = 1e-6, 1e6


class Sources(NamedTuple):
    """Where the limits of n joints are from: each `URDF`, `PARAMETER` or `DEFAULT`, (n,)."""

    position: tuple[str, ...]
    velocity: tuple[str, ...]
    acceleration: tuple[str, ...]
    jerk: tuple[str, ...]


class JointLimits(NamedTuple):
    """What n joints may do; the arrays are read-only.

    Attributes:
        position_min, position_max: (n,) [rad, m], infinite for continuous joints.
        velocity_max, acceleration_max: (n,) [rad/s, m/s; per s²].
        jerk_max: (n,) [rad/s³, m/s³], may be infinite.
        sources: of each.
    """

    position_min: Array
    position_max: Array
    velocity_max: Array
    acceleration_max: Array
    jerk_max: Array
    sources: Sources


def joint_limits(
    chain: Sequence[Joint], *, positions: Ranges | None, velocity_max: Values | None,
    acceleration_max: Values | None, jerk_max: Values | None,
) -> JointLimits:
    """Return the limits of a chain: what is given, or else the URDF's, or else a default.

    Args:
        chain: the joints.
        positions: ranges of some joints, within the URDF's.
        velocity_max, acceleration_max, jerk_max: one value, or one per joint, see `JointLimits`;
            None for the URDF's.

    Raises:
        RobotError: naming the joint and the limit that cannot be.
    """
    names = [joint.name for joint in chain]
    low, high, position_from = _positions(chain, positions or {})
    velocity, velocity_from = _given_or(
        'velocity_max', velocity_max, names, [joint.velocity for joint in chain],
        [0.0] * len(names))
    _check_size('velocity', velocity, velocity_from, names)
    acceleration, acceleration_from = _given_or(
        'acceleration_max', acceleration_max, names, [joint.acceleration for joint in chain],
        [ACCELERATION] * len(names))
    _check_size('acceleration', acceleration, acceleration_from, names)
    jerk, jerk_from = _given_or(
        'jerk_max', jerk_max, names, [joint.jerk for joint in chain], _JERK * acceleration)
    _check_jerk(jerk, jerk_from, acceleration, names)
    for array in (low, high, velocity, acceleration, jerk):
        array.setflags(write=False)
    return JointLimits(low, high, velocity, acceleration, jerk, Sources(
        position_from, velocity_from, acceleration_from, jerk_from))


def position_ranges(chain: Sequence[Joint]) -> tuple[Array, Array]:
    """Return the URDF's lowest and highest positions (n,), infinite for continuous joints."""
    for joint in chain:
        if joint.kind == 'continuous':
            continue
        if max(abs(joint.lower), abs(joint.upper)) > LARGEST:
            raise RobotError(
                f"joint '{joint.name}' has the limits {joint.lower} and {joint.upper}; they must "
                f'lie within ±{LARGEST:g} (a joint that turns without end is continuous)')
        if joint.lower == joint.upper:
            raise RobotError(f"joint '{joint.name}' cannot move: lower and upper of its limit are "
                             f'{joint.lower}; correct them or lock it')
    return (np.array([joint.lower for joint in chain]),
            np.array([joint.upper for joint in chain]))


def checked_weights(weights: Values, names: Sequence[str]) -> Array:
    """Return the weights (n,) of joints, which are given as one value or as n; read-only.

    Raises:
        RobotError: they are not as many as the joints, or not positive numbers.
    """
    given = floats_of(weights)
    if given.shape not in ((), (1,), (len(names),)) or not (
            (given > 0.0) & (given < np.inf)).all():
        raise RobotError(f'weights are {shown(weights)}; they must be one positive number, or one '
                         f'for each of {known(names)}')
    found = np.full(len(names), 1.0) * given
    found.setflags(write=False)
    return found


def _positions(
    chain: Sequence[Joint], given: Ranges,
) -> tuple[Array, Array, tuple[str, ...]]:
    """Return the lowest and highest positions (n,), and where they are from."""
    low, high = position_ranges(chain)
    names = [joint.name for joint in chain]
    for name, (lower, upper) in given.items():
        if name not in names:
            raise RobotError(f"position_limits name joint '{name}'; the chain has {known(names)}")
        j = names.index(name)
        what = f"position_limits of joint '{name}' are {lower:g}..{upper:g}"
        if not -LARGEST <= lower < upper <= LARGEST:
            raise RobotError(f'{what}; the first must be less than the second, and both must lie '
                             f'within ±{LARGEST:g}')
        if lower < low[j] or upper > high[j]:
            raise RobotError(f"{what}; they must lie within the URDF's, "
                             f'{low[j]:g}..{high[j]:g}')
        low[j], high[j] = lower, upper
    return low, high, tuple(PARAMETER if name in given else URDF for name in names)


def _given_or(
    what: str, given: Values | None, names: Sequence[str], described: Sequence[float],
    otherwise: Sequence[float] | Array,
) -> tuple[Array, tuple[str, ...]]:
    """Return the limits (n,) of a kind and where they are from.

    Args:
        what: the kind, as parameters call it.
        given: one value, or n; None for the URDF's.
        names: of the joints.
        described: (n,) by the URDF, 0 where it has none.
        otherwise: (n,) taken there.
    """
    if given is None:
        return (np.where(described, described, otherwise),
                tuple(URDF if limit else DEFAULT for limit in described))
    limits = floats_of(given)
    if limits.ndim > 1 or limits.size not in (1, len(names)):
        raise RobotError(f'{what} has {limits.size} values; it takes 1 or {len(names)}, one per '
                         f'joint: {known(names)}')
    return np.broadcast_to(limits.reshape(-1), (len(names),)).copy(), (PARAMETER,) * len(names)


def _check_size(
    kind: str, limits: Array, sources: Sequence[str], names: Sequence[str],
) -> None:
    for name, limit, source in zip(names, limits, sources):
        if source == DEFAULT and not limit:
            raise RobotError(f"joint '{name}' of the URDF has no {kind} limit; give {kind}_max")
        if not _SLOWEST <= limit <= _FASTEST:
            raise RobotError(f'{_what(kind, name, source)} is {limit}; it must lie in '
                             f'[{_SLOWEST:g}, {_FASTEST:g}]{_remedy(kind, source)}')


def _check_jerk(
    limits: Array, sources: Sequence[str], accelerations: Array, names: Sequence[str],
) -> None:
    for name, limit, source, acceleration in zip(names, limits, sources, accelerations):
        least = 2.0 * acceleration / _LONGEST_RAMP
        if not limit >= least:
            raise RobotError(
                f'{_what("jerk", name, source)} is {limit}; beside an acceleration_max of '
                f'{acceleration:g} it must be {least:g} or more, so that the joint turns its '
                f'acceleration round within {_LONGEST_RAMP:g} s{_remedy("jerk", source)}')


def _what(kind: str, joint: str, source: str) -> str:
    return (f"{kind} of the limit of joint '{joint}' of the URDF" if source == URDF else
            f"{kind}_max of joint '{joint}'")


def _remedy(kind: str, source: str) -> str:
    return f'; {kind}_max replaces it' if source == URDF else ''

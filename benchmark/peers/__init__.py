"""What users would pick instead, on the very same arm, driven tick by tick.

Each gets the joint limits of position and velocity, this package's capsules and obstacles, the
same pairs of links that shall not meet, and the pose where the tip should be after the tick. Each
is set up as its authors' examples do. The libraries are for benchmarks only, and each is imported
only where it is asked for.

| name | what it is | shapes | acceleration limits | links apart by |
|---|---|---|---|---|
| mink | mink's QP with its collision limit | all | none | the margin between links |
| pink | pink's QP with its collision barrier | all | none | the margin between links |
| roboplan | RoboPlan's OInK, barrier and priorities | all | yes | the margin between links |
| neo | NEO's QP (Haviland and Corke 2021) | all | none | nothing: it has no pairs of links |
| cbfpy | OSCBF's velocity filter on cbfpy | all | none | the margin between links |

None knows jerk limits, the twist to come, or half-spaces.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]


class Peer(Protocol):
    """A library bound to one arm and one set of obstacles."""

    def step(self, q: Array, target: Pose, dt: float) -> Array:
        """Return the joint velocities (n,) towards a tip pose that is due after `dt`.

        Zero where the library finds no solution. Those of `OF_SEVERAL_TIPS` take poses of all
        tips, too.
        """

    def move(self, obstacles: Sequence[Obstacle]) -> None:
        """Take the same obstacles' new places."""


class MissingPeerError(ImportError):
    """A library is not installed: the message says which, and how to install it."""


class _Entry(NamedTuple):
    module: str
    needs: tuple[str, ...]
    packages: tuple[str, ...]


# Class → its module here, the modules that it imports and the packages that have them.
_ENTRIES = {
    'Mink': _Entry('mink', ('mink', 'mujoco', 'daqp'), ('mink', 'daqp')),
    'Pink': _Entry('pink', ('pink', 'daqp'), ('pin-pink', 'daqp')),
    'RoboPlan': _Entry('roboplan', ('roboplan',), ('roboplan',)),
    'Neo': _Entry('neo', ('daqp', 'coal'), ('daqp', 'coal')),
    'CbfPy': _Entry('cbfpy', ('cbfpy', 'jax'), ('cbfpy',)),
}
# Name of a method → class. Some are driven with several tips, too.
PEERS = {name.lower(): name for name in _ENTRIES}
OF_SEVERAL_TIPS = ('mink', 'pink')


def missing(name: str) -> str:
    """Return what a method of `PEERS` lacks and how to install it; empty if it lacks nothing."""
    entry = _ENTRIES[PEERS[name]]
    absent = [module for module in entry.needs if find_spec(module) is None]
    if not absent:
        return ''
    return f'{name}: there is no {", ".join(absent)}; pip install {" ".join(entry.packages)}'


def library(name: str) -> Callable[..., Peer]:
    """Return the class of a method of `PEERS`.

    It takes the robot, its obstacles, the margin to obstacles and that between links [m].

    Raises:
        MissingPeerError: it is not installed.
    """
    lack = missing(name)
    if lack:
        raise MissingPeerError(lack)
    entry = _ENTRIES[PEERS[name]]
    return getattr(import_module(f'{__name__}.{entry.module}'), PEERS[name])


def installed() -> list[str]:
    """Return the methods of `PEERS` that can run here."""
    return [name for name in PEERS if not missing(name)]


def versions() -> dict[str, str]:
    """Return the versions of what is compared, of the packages that are installed."""
    found = {}
    for name in ('mink', 'mujoco', 'pin-pink', 'pin', 'daqp', 'roboplan', 'cbfpy', 'jax'):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found

"""Mass and inertia of the links, as a URDF gives them or, where it does not, as assumed."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple
import xml.etree.ElementTree as ElementTree

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known
from redundant_planner.core.robot.urdf import MOVABLE, numbers, Urdf

Array = npt.NDArray[np.float64]

# Of links without an inertia: that of their capsules [kg/m³], without those a ball's [kg, m].
DENSITY = 1000.0
BALL_MASS, BALL_RADIUS = 0.1, 0.05
# Less mass [kg] or inertia [kg m²] than this is none.
_LEAST_MASS, _LEAST_INERTIA = 1e-9, 1e-12


class Inertia(NamedTuple):
    """Mass and inertia of a link.

    Attributes:
        mass: [kg].
        center: (3,) of mass, in the link's frame [m].
        matrix: (3, 3) about the centre of mass, in the link's axes [kg m²].
    """

    mass: float
    center: Array
    matrix: Array


def ball() -> Inertia:
    """Return the inertia of a link of which nothing is known."""
    return Inertia(BALL_MASS, np.zeros(3), 0.4 * BALL_MASS * BALL_RADIUS**2 * np.eye(3))


def inertias(urdf: Urdf) -> dict[str, Inertia]:
    """Return the inertia of each link that has one.

    A link without mass, or whose inertia matrix is not positive definite, has none.

    Raises:
        RobotError: a number of an <inertial> is missing or malformed.
    """
    found = {}
    for name, link in urdf.links.items():
        inertia = _inertia(name, link)
        if inertia is not None:
            found[name] = inertia
    return found


def bodies_without_inertia(urdf: Urdf, known_ones: Collection[str]) -> list[str]:
    """Return the links that a joint moves and that have no inertia, nor has what is fixed to them.

    Args:
        urdf: the links and joints.
        known_ones: the links that have an inertia.
    """
    rigid = {joint.child: joint.parent for joint in urdf.joints if joint.kind not in MOVABLE}

    def carrier(link: str) -> str:
        while link in rigid:
            link = rigid[link]
        return link

    heavy = {carrier(link) for link in known_ones}
    return [joint.child for joint in urdf.joints
            if joint.kind in MOVABLE and joint.child not in heavy]


def remark_on(assumed: Collection[str]) -> str:
    """Return the sentence about links whose inertia is assumed."""
    return (f'the URDF gives no inertia of {known(assumed)}: it is assumed to be that of their '
            f'capsules at {DENSITY:g} kg/m³, or of a ball of {BALL_MASS:g} kg where there is none')


def _inertia(name: str, link: ElementTree.Element) -> Inertia | None:
    element = link.find('inertial')
    if element is None:
        return None
    what = f"the inertial of link '{name}'"
    origin, matrix = element.find('origin'), element.find('inertia')
    (mass,) = numbers(element.find('mass'), 'value', what, default=(0.0,))
    center = numbers(origin, 'xyz', what, default=(0.0, 0.0, 0.0))
    turn = rotation_of(numbers(origin, 'rpy', what, default=(0.0, 0.0, 0.0)))
    xx, xy, xz, yy, yz, zz = (
        numbers(matrix, key, what, default=(0.0,))[0]
        for key in ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'))
    about_center = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if mass < _LEAST_MASS or np.linalg.eigvalsh(about_center)[0] < _LEAST_INERTIA:
        return None
    return Inertia(mass, np.array(center), turn @ about_center @ turn.T)


def rotation_of(rpy: tuple[float, ...]) -> Array:
    """Return the rotation matrix (3, 3) of a URDF's roll, pitch and yaw [rad]."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr]])

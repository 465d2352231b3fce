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
    return Inertia(BALL_MASS, np.zeros(3), _ball_matrix(BALL_MASS))


def inertias(urdf: Urdf) -> tuple[dict[str, Inertia], list[str]]:
    """Return the inertia of each link that has a mass, and the links of which it is a ball's.

    Those are links whose inertia matrix is not positive definite, as of a tool of which only the
    mass is known: they get the matrix of a ball of that mass.

    Raises:
        RobotError: a number of an <inertial> is missing or malformed.
    """
    found, balls = {}, []
    for name, link in urdf.links.items():
        inertia = _inertia(name, link)
        if inertia is None:
            continue
        if np.linalg.eigvalsh(inertia.matrix)[0] < _LEAST_INERTIA:
            inertia = inertia._replace(matrix=_ball_matrix(inertia.mass))
            balls.append(name)
        found[name] = inertia
    return found, balls


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


def remarks_on(assumed: Collection[str], balls: Collection[str]) -> list[str]:
    """Return the sentences about links whose inertia is assumed.

    Args:
        assumed: links without a mass that need one.
        balls: links whose inertia matrix is none.
    """
    remarks = []
    if assumed:
        remarks.append(
            f'the URDF gives no inertia of {known(assumed)}: it is assumed to be that of their '
            f'capsules at {DENSITY:g} kg/m³, or of a ball of {BALL_MASS:g} kg where there is none')
    if balls:
        remarks.append(
            f'the inertia matrix of {known(balls)} in the URDF is not positive definite: it is '
            f'assumed to be that of a ball of {2.0 * BALL_RADIUS:g} m with the mass given there')
    return remarks


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
    if mass < _LEAST_MASS:
        return None
    return Inertia(mass, np.array(center), turn @ about_center @ turn.T)


def _ball_matrix(mass: float) -> Array:
    return 0.4 * mass * BALL_RADIUS**2 * np.eye(3)


def rotation_of(rpy: tuple[float, ...]) -> Array:
    """Return the rotation matrix (3, 3) of a URDF's roll, pitch and yaw [rad]."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr]])

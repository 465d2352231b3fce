"""Meshes of a URDF in metres: where their files are, and what a length in them stands for."""

from __future__ import annotations

import math
from pathlib import Path
import xml.etree.ElementTree as ElementTree

from redundant_planner.core.errors import RobotError, shown
from redundant_planner.core.robot.urdf import Numbers, numbers
from redundant_planner.io.resources import resolve

_COLLADA = '.dae'


def mesh_unit(path: Path) -> float:
    """Return how many metres a length of 1 in a mesh file stands for.

    Only Collada files say so. RViz heeds it, and Pinocchio does not; both leave `up_axis` aside.

    Raises:
        RobotError: it is not a positive number.
    """
    if path.suffix.lower() != _COLLADA:
        return 1.0
    try:
        said = _collada_unit(path)
    except (OSError, ElementTree.ParseError):
        return 1.0  # what reads the mesh will say what is wrong
    try:
        unit = float(said)
    except ValueError:
        unit = math.nan
    if not 0.0 < unit < math.inf:
        raise RobotError(f"'{path}' has <unit meter={shown(said)}>; it takes a positive number, "
                         'the metres that a length of 1 stands for')
    return unit


def mesh_scale(mesh: ElementTree.Element, file: Path, what: str) -> Numbers:
    """Return by what a URDF's <mesh> multiplies the lengths in its file, unit included (3,).

    Args:
        mesh: the element.
        file: that it names.
        what: the element is, for messages.

    Raises:
        RobotError: its scale or the file's unit cannot be used.
    """
    scale = numbers(mesh, 'scale', what, default=(1.0, 1.0, 1.0))
    if 0.0 in scale:
        raise RobotError(f'{what} has a scale of 0')
    try:
        unit = mesh_unit(file)
    except RobotError as error:
        raise RobotError(f'{what}: {error}') from None
    return tuple(unit * factor for factor in scale)


def with_meshes_in_metres(urdf: str, folder: Path | None) -> str:
    """Return a URDF for Pinocchio's reader, whose collision meshes are named by absolute paths.

    Args:
        urdf: its text.
        folder: of the URDF, for relative paths.

    Raises:
        PlannerError: a mesh is not there, or its scale or unit cannot be used.
    """
    tree = ElementTree.fromstring(urdf)
    for link in tree.findall('link'):
        for mesh in link.findall('collision/geometry/mesh'):
            file = resolve(mesh.get('filename', ''), folder)
            scale = mesh_scale(mesh, file, f"the mesh of link '{link.get('name', '')}'")
            mesh.set('filename', str(file))
            mesh.set('scale', ' '.join(map(repr, scale)))
    return ElementTree.tostring(tree, encoding='unicode')


def _collada_unit(path: Path) -> str:
    """Return what a Collada file says of its unit, '1' where it says nothing."""
    with path.open('rb') as file:
        for event, element in ElementTree.iterparse(file, ('start', 'end')):
            tag = element.tag.rpartition('}')[2]
            if tag == 'unit':
                return str(element.get('meter', '1'))
            # <asset> comes first, and no other one is about the whole file.
            if tag.startswith('library_') or (event, tag) == ('end', 'asset'):
                break
    return '1'

"""Capsules for an arm's links, fitted to the collision geometry of its URDF."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import contextlib
from dataclasses import dataclass
import hashlib
import json
import os
from pathlib import Path
import tempfile
from typing import Any

import numpy as np
import numpy.typing as npt

from redundant_planner.core.cache_folder import cache_folder
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.collision_geometry import (
    collision_elements,
    CollisionElement,
    MOST_ON_JOINT,
    Piece,
    piece_of,
)
from redundant_planner.io.hand_openings import Openings, openings_of

Array = npt.NDArray[np.float64]

# Changes when the fit does, so that older results in the cache are not taken for its own.
_VERSION = 4


@dataclass(frozen=True)
class Fit:
    """What a fit made of the links that one joint carries, or of those that stand still.

    Attributes:
        joint: its name; the base frame's of what stands still.
        links: theirs.
        capsules: around them.
        corners: points that had to be enclosed.
        ratio: volume of the capsules over that of the convex bodies; infinite for flat ones.
        bare: links that stand still of which some body has no capsule: it would stick out far, or
            there are too many.
    """

    joint: str
    links: tuple[str, ...]
    capsules: tuple[Capsule, ...]
    corners: int
    ratio: float
    bare: tuple[str, ...] = ()


def fitted_capsules(
    robot: Robot, folder: Path | None, *, held: Mapping[str, float] | None = None,
    cache: bool = True,
) -> tuple[Fit, ...]:
    """Return capsules around every link that the chain's joints move, and a hand at any opening.

    Around what is fixed to the base, too, where they fit closely.

    Args:
        robot: the arm, its own capsules do not matter.
        folder: of the URDF, for relative mesh paths.
        held: joint name → where it is locked [rad, m]; fingers that are locked stay there.
        cache: whether a fit of the same URDF and meshes is looked up and kept (`cache_folder`).

    Raises:
        RobotError: a collision element or mesh cannot be used, or no link has any.
    """
    elements = collision_elements(robot, folder)
    kept = cache_folder() if cache else None
    openings = openings_of(robot, held or {})
    if kept is None:
        return tuple(_fit(robot, map(piece_of, elements), openings))
    key = _key(robot, elements, openings)
    file = kept / f'capsules-{key[:32]}.txt'
    fits = _read(file, key, elements)
    if fits is None:
        fits = tuple(_fit(robot, map(piece_of, elements), openings))
        _write(file, key, fits)
    return fits


def larger_than_the_rest(robot: Robot) -> list[str]:
    """Return a sentence for each capsule that is longer than the arm without its link.

    Those are meshes whose lengths are not metres. A link counts by its capsules, and by how far
    it carries the next joint.
    """
    joints = robot.chain.capsule_joint
    lengths = np.array([float(np.linalg.norm(c.end - c.start)) + 2.0 * c.radius
                        for c in robot.capsules])
    carried, chain = np.zeros(robot.n + 1), robot.chain
    np.maximum.at(carried, chain.parents, np.linalg.norm(chain.offset, axis=1))
    np.maximum.at(carried, chain.tip_joints, np.linalg.norm(chain.tip_from_joint, axis=1))
    said = []
    for c, joint, length in zip(robot.capsules, joints, lengths):
        shapes = np.bincount(joints[joints != joint], lengths[joints != joint], robot.n + 1)[1:]
        rest = float(np.maximum(shapes, carried[1:]).sum())
        if joint > 0 and length > rest:
            said.append(
                f"the shape of link '{c.name}' is {length:.3g} m long, the rest of the arm "
                f'{rest:.3g} m: are the lengths in its mesh metres, and is its scale right?')
    return said


def _fit(robot: Robot, pieces: Iterable[Piece], openings: Openings) -> Iterable[Fit]:
    from redundant_planner.core.robot.capsule_fit import (
        convex_hull,
        fit_body,
        fit_closely,
        merged,
        Shape,
    )

    by_joint: dict[str, list[Piece]] = {}
    for piece in pieces:
        by_joint.setdefault(piece.joint, []).append(piece)
    for joint in (name for name in (robot.base_frame, *robot.joint_names) if name in by_joint):
        group = by_joint[joint]
        base = _base_of(robot, joint, [piece.link for piece in group], openings)
        shapes: list[tuple[Shape, Array]] = []
        bare: dict[str, None] = {}
        owners, volume, corners, bulge = [], 0.0, 0, 0.0
        stands = joint == robot.base_frame
        for piece in group:
            if stands and len(shapes) >= MOST_ON_JOINT:
                bare[piece.link] = None
                continue
            # All in the frame of one link: they are one rigid body, but for the hand's openings.
            points, more = openings.points_of(base, piece.link, piece.points)
            corners, bulge = corners + len(points), max(bulge, more)
            if piece.radius is not None and piece.link not in openings.links:
                shape = Shape(points[0], points[1], piece.radius)
                shapes.append((shape, np.vstack([_around(end, piece.radius) for end in points])))
                owners.append(piece.link)
                volume += shape.volume
                continue
            if piece.radius is not None:
                points = np.vstack([_around(end, piece.radius) for end in points])
            body = convex_hull(points)
            parts = fit_closely(body) if stands else fit_body(body)
            if parts is None:
                bare[piece.link] = None
                continue
            volume += body.volume
            shapes += parts
            owners += [piece.link] * len(parts)
        capsules: list[Capsule] = []
        # Merging saves volume; what stands still has to be covered closely.
        whole = ([(shape, owner) for (shape, _), owner in zip(shapes, owners)] if stands else
                 [(shape, owners[members[0]]) for shape, _, members in merged(shapes)])
        for shape, name in whole:
            taken = sum(c.name == name or c.name.startswith(f'{name}_') for c in capsules)
            # Outwards by what is lost when the numbers are written down.
            radius = shape.radius + bulge + 1e-5
            capsules.append(Capsule(f'{name}_{taken + 1}' if taken else name, base,
                                    np.round(shape.start, 5), np.round(shape.end, 5),
                                    float(np.ceil(radius * 1e5) / 1e5)))
        total = sum(Shape(c.start, c.end, c.radius).volume for c in capsules)
        yield Fit(joint, tuple(dict.fromkeys(p.link for p in group)), tuple(capsules), corners,
                  total / volume if volume > 0.0 else np.inf, tuple(bare))


def _base_of(robot: Robot, joint: str, links: Sequence[str], openings: Openings) -> str:
    """Return the link whose frame a joint's capsules are in: one that no finger's joint moves."""
    still = [link for link in links if link not in openings.links]
    others = (link for link, carrier in robot.moving_links.items()
              if carrier == joint and link not in openings.links)
    return still[0] if still else next(others)


def _around(center: Array, radius: float) -> Array:
    """Return the corners (20, 3) of a dodecahedron around a ball."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T.astype(float)
    flat = signs[signs[:, 0] > 0] * np.array((0.0, 1.0 / golden, golden))
    corners = np.vstack((signs, *(np.roll(flat, i, axis=1) for i in range(3))))
    inner = golden ** 2 / np.sqrt(3.0 - golden) / 2.0 * (2.0 / golden)
    return center + corners * (radius / inner)


def _key(robot: Robot, elements: Sequence[CollisionElement], openings: Openings) -> str:
    """Return what tells one fit from another."""
    digest = hashlib.sha256(f'{_VERSION} {robot.joint_names} {elements}'.encode())
    links: dict[str, list[str]] = {}
    for element in elements:
        links.setdefault(element.joint, []).append(element.link)
    for element in elements:
        # Links on one joint are one body: how they stand to each other matters.
        base = _base_of(robot, element.joint, links[element.joint], openings)
        digest.update(openings.points_of(base, element.link, np.eye(4, 3))[0].tobytes())
        if element.mesh:
            with contextlib.suppress(OSError):  # it is gone: reading it will say so
                status = os.stat(element.mesh)
                digest.update(f'{status.st_size} {status.st_mtime_ns}'.encode())
    return digest.hexdigest()


def _read(file: Path, key: str, elements: Sequence[CollisionElement]) -> tuple[Fit, ...] | None:
    """Return the fits that a file holds, None if there is none, or not as it was written."""
    try:
        seal, _, content = file.read_bytes().partition(b'\n')
        if seal != _seal(key, content):
            return None
        fits = tuple(_fit_of(entry) for entry in json.loads(content))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    links: dict[str, dict[str, None]] = {}
    for element in elements:
        links.setdefault(element.joint, {})[element.link] = None
    covered = {fit.joint: dict.fromkeys(fit.links) for fit in fits if fit.capsules or fit.bare}
    return fits if covered == links else None


def _write(file: Path, key: str, fits: Sequence[Fit]) -> None:
    """Keep fits for the next start, whole or not at all."""
    content = json.dumps([
        {'joint': fit.joint, 'links': fit.links, 'corners': fit.corners, 'ratio': fit.ratio,
         'bare': fit.bare, 'capsules': [capsule_entry(c) | {'name': c.name} for c in fit.capsules]}
        for fit in fits]).encode()
    # A folder that cannot be written to costs some seconds at the next start.
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=file.parent)
        try:
            with os.fdopen(handle, 'wb') as stream:
                stream.write(_seal(key, content) + b'\n' + content)
            os.replace(name, file)
        except OSError:
            Path(name).unlink(missing_ok=True)


def _seal(key: str, content: bytes) -> bytes:
    """Return a digest that no damaged content has, nor that of another arm."""
    return hashlib.sha256(key.encode() + content).hexdigest().encode()


def _fit_of(entry: dict[str, Any]) -> Fit:
    return Fit(
        entry['joint'], tuple(entry['links']),
        tuple(Capsule(c['name'], c['frame'], c['start'], c['end'], c['radius'])
              for c in entry['capsules']),
        int(entry['corners']), float(entry['ratio']), tuple(entry['bare']))


def capsule_entry(capsule: Capsule) -> dict[str, Any]:
    """Return a capsule as it stands in a parameter file."""
    return {'frame': capsule.frame, 'start': capsule.start.tolist(),
            'end': capsule.end.tolist(), 'radius': capsule.radius}

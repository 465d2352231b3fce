"""One published scene, and what reading one can come to."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]


class PublishedError(ValueError):
    """A folder does not hold what it should: the message says which file and where to get it."""


@dataclass(frozen=True)
class Scene:
    """What an arm is asked to do.

    Attributes:
        name: of the scene.
        start: (7,) posture of a Panda [rad].
        obstacles: at the start; they move on by their velocities.
        goal: position (3,) where the tip shall be [m], with 6 axes turned as at the start; None
            for a path.
        path: (k, 3) offsets and (k, 3, 3) turns from the tip's first pose, with (k,) times [s].
        axes: that count, 3 or 6.
        near: of the goal [m].
        longest: run [s].
        tool: how far the set's tip lies beyond the Panda's hand frame, along its z [m].
    """

    name: str
    start: Array
    obstacles: tuple[Obstacle, ...]
    goal: Array | None = None
    path: tuple[Array, Array, Array] | None = None
    axes: int = 6
    near: float = 0.005
    longest: float = 30.0
    tool: float = 0.0

    def at(self, time: float) -> tuple[Obstacle, ...]:
        """Return where the obstacles are at a time [s]."""
        return tuple(obstacle.after(time) for obstacle in self.obstacles)

    def goal_pose(self, start: Pose) -> Pose | None:
        """Return where the hand has to be, with the orientation that it starts with."""
        return None if self.goal is None else Pose(
            self.goal - self.tool * start.rotation[:, 2], start.rotation)


def ball(name: str, center: Array, radius: float, velocity: Array | None = None) -> Obstacle:
    """Return a sphere [m, m/s]."""
    return Obstacle(name, center, np.full(3, radius),
                    velocity=np.zeros(3) if velocity is None else velocity)


def text_of(folder: Path, name: str, repository: str) -> str:
    """Return a file's text.

    Raises:
        PublishedError: it is not there.
    """
    try:
        return (folder / name).read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, 'strerror', None) or error
        raise PublishedError(f'{folder / name}: {why}; the folder has to be a checkout of '
                             f'https://github.com/{repository}') from None


def tree_of(folder: Path, name: str, repository: str) -> ast.Module:
    """Return a Python file, parsed and not run.

    Raises:
        PublishedError: it is not there, or not Python.
    """
    try:
        return ast.parse(text_of(folder, name, repository))
    except (SyntaxError, ValueError) as error:
        raise PublishedError(f'{folder / name}: not Python: {error}') from None


def number(node: ast.expr) -> float:
    """Return the value of an arithmetic expression of numbers and pi.

    Raises:
        PublishedError: it is anything else.
    """
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        return float(node.value)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return -number(node.operand)
    if isinstance(node, ast.Attribute) and node.attr == 'pi':
        return math.pi
    if isinstance(node, ast.BinOp):
        left, right = number(node.left), number(node.right)
        if isinstance(node.op, ast.Div) and right != 0.0:
            return left / right
        for kind, value in ((ast.Mult, left * right), (ast.Add, left + right),
                            (ast.Sub, left - right)):
            if isinstance(node.op, kind):
                return value
    raise PublishedError(f'{ast.unparse(node)} is no number')


def numbers(node: ast.expr) -> Array:
    """Return the values (k,) of a list or tuple, also as an argument of np.array."""
    if isinstance(node, ast.Call) and node.args:
        node = node.args[0]
    if not isinstance(node, (ast.List, ast.Tuple)):
        raise PublishedError(f'{ast.unparse(node)} is no list of numbers')
    return np.array([number(item) for item in node.elts])


def keyword(call: ast.Call, name: str) -> ast.expr | None:
    """Return a call's keyword argument."""
    return next((word.value for word in call.keywords if word.arg == name), None)


def calls(tree: ast.AST, name: str) -> Iterator[ast.Call]:
    """Yield the calls of a function, by the end of its dotted name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and f'.{ast.unparse(node.func)}'.endswith(f'.{name}'):
            yield node

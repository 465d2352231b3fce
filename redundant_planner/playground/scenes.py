"""The scenes of the page: which arms, where they start, and what stands around them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, ELLIPSOID, Obstacle
from redundant_planner.io.resources import share_directory
from redundant_planner.io.scenario import load_scenario
from redundant_planner.playground.world import Item, Numbers

_PANDA_START = dict(zip((f'panda_joint{i}' for i in range(1, 8)),
                        (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)))
# In the crowd: how many, within which distance of the base, and how far they swing [m].
_CROWD, _CLOSE, _WIDE, _SWING = 12, 0.45, 0.95, 0.25


@dataclass(frozen=True)
class ArmSetup:
    """An arm of a scene, with the processes that make it one.

    Attributes:
        start: joint name → position at the start [rad, m].
        robot_file: its parameter file; None for the one the page was started with.
        namespace: of its nodes.
        files: more parameter files of its nodes.
    """

    start: Mapping[str, float]
    robot_file: Path | None = None
    namespace: str = ''
    files: tuple[Path, ...] = ()


@dataclass(frozen=True)
class PageScene:
    """What one choice among the scenes brings.

    Attributes:
        title: what the page calls it.
        hint: what to try there, in one sentence.
        items: what stands there.
        arms: the arms.
    """

    title: str
    hint: str
    items: tuple[Item, ...] = ()
    arms: tuple[ArmSetup, ...] = field(default_factory=lambda: (ArmSetup(_PANDA_START),))


def page_scenes(robot_file: Path | None) -> tuple[PageScene, ...]:
    """Return all scenes; the page begins with the first one.

    Args:
        robot_file: of the user's own arm, which starts where its file says; None for a Panda.
    """
    if robot_file is not None:
        arm = (ArmSetup({}),)
        return (PageScene('Nothing around', 'Add obstacles, and drive.', (), arm),
                replace(_crowd(), arms=arm))
    return (_past_spheres(), _table_and_shelf(), _crowd(), _two_arms(), _paper())


def _past_spheres() -> PageScene:
    scenario = _config('scenarios', 'panda_obstacles.yaml')
    return PageScene(
        'Panda past obstacles', 'Hold A: the hand goes sideways, and the elbow makes way.',
        tuple(_item(obstacle) for obstacle in load_scenario(scenario).obstacles))


def _table_and_shelf() -> PageScene:
    def board(name: str, height: float) -> Item:
        return Item(name, BOX, (0.35, 0.7, 0.02), (0.72, 0.0, height))
    return PageScene(
        'Table and shelf', 'Drag the handle at the tip into the shelf, and out again.',
        (Item('table', BOX, (0.5, 0.9, 0.04), (0.0, 0.75, 0.2)),
         Item('box on the table', BOX, (0.15, 0.15, 0.2), (0.1, 0.62, 0.33)),
         board('lower board', 0.25), board('middle board', 0.62), board('upper board', 0.95),
         Item('left side', BOX, (0.35, 0.02, 0.95), (0.72, 0.36, 0.475)),
         Item('right side', BOX, (0.35, 0.02, 0.95), (0.72, -0.36, 0.475)),
         Item('back', BOX, (0.02, 0.74, 0.95), (0.9, 0.0, 0.475))))


def _crowd() -> PageScene:
    random = np.random.default_rng(3)
    items = []
    for i in range(_CROWD):
        angle, away = random.uniform(-2.4, 2.4), random.uniform(_CLOSE, _WIDE)
        swing = random.uniform(-1.0, 1.0, 3)
        shape = (ELLIPSOID, BOX, CYLINDER, CAPSULE)[i % 4]
        items.append(Item(
            f'passer-by {i + 1}', shape, (0.1, 0.1, 0.1 if shape == ELLIPSOID else 0.16),
            (away * float(np.cos(angle)), away * float(np.sin(angle)),
             float(random.uniform(0.25, 0.9))),
            swing=_numbers(_SWING * swing / np.linalg.norm(swing)),
            period=float(random.uniform(9.0, 14.0))))
    return PageScene('Moving crowd', 'Let go: the arm evades what comes, and goes back.',
                     tuple(items))


def _two_arms() -> PageScene:
    files = (_config('planner', 'two_arms.yaml'),)
    return PageScene(
        'Two arms', 'Drive one into the other: it keeps clear, and the other one makes way.',
        (), tuple(ArmSetup(_PANDA_START, namespace=side, files=files)
                  for side in ('left', 'right')))


def _paper() -> PageScene:
    scenario = load_scenario(_config('scenarios', 'paper.yaml'))
    return PageScene(
        "The paper's arm", 'Hold S and D: section 4 of the paper, past its ellipsoid.',
        tuple(_item(obstacle) for obstacle in scenario.obstacles),
        (ArmSetup(scenario.start, scenario.robot_file),))


def _config(folder: str, file: str) -> Path:
    return share_directory() / 'config' / folder / file


def _item(obstacle: Obstacle) -> Item:
    return Item(obstacle.name, obstacle.shape, _numbers(2.0 * obstacle.half_extents),
                _numbers(obstacle.center), _numbers(obstacle.orientation))


def _numbers(values: np.ndarray) -> Numbers:
    return tuple(values.tolist())

"""Draws and tabulates docs/horizon.md: `python -m benchmark.horizon_figure`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from benchmark.generator import DURATION, generate, path_poses
from benchmark.optimum import Optimum
from benchmark.robots import make_robot
from benchmark.scenarios import DT
from redundant_planner.analysis import metrics
from redundant_planner.analysis.figures import joint_curves
from redundant_planner.core.horizon.preview import Preview
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import integrate, Pose
from redundant_planner.paper import experiment
from redundant_planner.simulation import simulate

Array = npt.NDArray[np.float64]

_FOLDER = Path(__file__).resolve().parent.parent / 'docs' / 'figures'
_STYLES = {'traditional': '--', 'dynamic factor': '-.', 'variational': '-', 'optimum': ':'}
_OURS = {'dynamic factor': PlannerParameters(),
         'variational': PlannerParameters(method='variational')}
# The first from 2001 on that every method completes.
_PANDA_SEED = 2002


@dataclass(frozen=True)
class Task:
    """An arm and the motion that its tip shall make.

    Attributes:
        robot: the arm.
        start: (n,) posture.
        twist_at: the tip's twist (6,) at a time [s].
        preview: the same twists, known in advance.
        duration: of the motion [s].
        poses: of the tip, one a tick.
        obstacles: that stand still.
    """

    robot: Robot
    start: Array
    twist_at: Callable[[float], Array]
    preview: Preview
    duration: float
    poses: Sequence[Pose]
    obstacles: Sequence[Obstacle]


def compare(
    task: Task, methods: Mapping[str, PlannerParameters],
) -> dict[str, tuple[Array, Array]]:
    """Return name → (times, postures) of every method and of the optimum."""
    scene, found = Scene.of(task.obstacles), {}
    for name, parameters in methods.items():
        motion = simulate(Planner(task.robot, parameters), task.start, task.twist_at, scene,
                          task.duration, DT, task.preview)
        found[name] = motion.times, motion.positions
    margin = methods['variational'].clearance_margin
    best = Optimum(task.robot, task.start, task.poses, DT, task.obstacles, margin).best(
        [positions for _, positions in found.values()])
    assert best is not None
    found['optimum'] = np.linspace(0.0, task.duration, len(best[1])), best[1]
    return found


def print_table(title: str, robot: Robot, found: dict[str, tuple[Array, Array]]) -> None:
    """Print the effort, its ratio to the optimum, and the joint path by kind of joint."""
    table = Table(title=title)
    for heading in ('method', '∫q̇ᵀq̇ dt', '/ optimum', 'Σ|Δq| prismatic', 'Σ|Δq| revolute'):
        table.add_column(heading, justify='right')
    prismatic = np.array([not np.any(np.array(joint.createData().S)[3:])
                          for joint in list(robot.model.joints)[1:]])

    def effort(name: str) -> float:
        times, positions = found[name]
        return float((np.diff(positions, axis=0) ** 2).sum() / (times[1] - times[0]))

    for name, (_, positions) in found.items():
        path = metrics.joint_path(positions)
        table.add_row(name, f'{effort(name):.5f}', f'{effort(name) / effort("optimum"):.3f}',
                      f'{path[prismatic].sum():.4f}', f'{path[~prismatic].sum():.4f}')
    Console(width=120).print(table)


def main() -> None:
    """Draw both figures and print both tables."""
    scenario = experiment.paper_scenario()
    robot = experiment.paper_robot(scenario)
    start = scenario.start_posture(robot)
    arm = robot.kinematics(start)
    poses = [Pose(arm.tip_position, arm.tip_rotation)]
    for i in range(round(scenario.duration / DT)):
        poses.append(integrate(poses[-1], scenario.twist_at(i * DT), DT, False))
    traditional = replace(experiment.methods()['gradient_projection_links'],
                          clearance_margin=PlannerParameters().clearance_margin)
    task = Task(robot, start, scenario.twist_at, scenario.preview(), scenario.duration, poses,
                scenario.obstacles)
    found = compare(task, {'traditional': traditional, **_OURS})
    print_table("The paper's scenario, whole links clear by the default margin", robot, found)
    columns = [robot.joint_names.index(name) for name in experiment.JOINTS]
    joint_curves(_FOLDER / 'horizon_paper.png', experiment.JOINTS, 'position [rad, m]',
                 {name: (_STYLES[name], times, positions[:, columns])
                  for name, (times, positions) in found.items()},
                 "The paper's scenario, whole links clear")

    robot = make_robot('panda', 6)
    motion = generate(robot, _PANDA_SEED)
    ticks = np.linspace(0.0, DURATION, round(DURATION / DT) + 1)
    task = Task(robot, motion.start, motion.twist_at, Preview(ticks, motion.twist_at(ticks)),
                DURATION, path_poses(robot, motion, DT), motion.obstacles)
    traditional = PlannerParameters(method='gradient_projection', criteria_k_fixed=0.02,
                                    criteria_k_w=1.0, criteria_k_f=0.0)
    found = compare(task, {'traditional': traditional, **_OURS})
    print_table(f'A Panda, scenario {_PANDA_SEED} of the benchmark', robot, found)
    joint_curves(_FOLDER / 'horizon_panda.png', robot.joint_names, 'position [rad]',
                 {name: (_STYLES[name], *curve) for name, curve in found.items()},
                 f'A Panda, scenario {_PANDA_SEED} of the benchmark')


if __name__ == '__main__':
    main()

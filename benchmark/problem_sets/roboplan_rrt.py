"""RoboPlan's planner from its example: RRT-Connect, shortcuts, and times by TOPP-RA.

It gets what this package does not: the goal's posture, rather than where the tip shall be. Its
links are this package's capsules, thicker by the margins. Its time law knows no jerk limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, compress
from pathlib import Path
import tempfile
import time

import numpy as np
import numpy.typing as npt
from roboplan.core import (
    Box,
    Cylinder,
    JointConfiguration,
    loadJointLimitsConfig,
    loadMjcfModel,
    PathShortcutter,
    PathShortcuttingOptions,
    Scene,
    Sphere,
)
from roboplan.rrt import RRT, RRTOptions
from roboplan.toppra import PathParameterizerTOPPRA, SplineFittingMode, TOPPRAOptions

from benchmark.peers.mjcf import mjcf
from benchmark.problem_sets.problem import Problem
from benchmark.problem_sets.servo import DT, Run
from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, ELLIPSOID, Obstacle
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# As in the example, but for the step at which edges are checked: with its 0.05 rad a tip moves
# further than the margin [rad].
_STEP, _CONNECTION = 0.01, 1.0
_SHORTCUTS = 1000
# Nodes and time after which it gives up [s].
_MOST_NODES, _PATIENCE = 100_000, 10.0
# Limits that are none.
_ANY = 1e3
_GRAY = np.full(4, 0.5)


def planned(robot: Robot, problem: Problem, margin: float, seed: int = 0) -> Run:
    """Return the motion that RoboPlan plans, in ticks of `DT`; its one tick of CPU is planning.

    Args:
        robot: the arm.
        problem: what to do.
        margin: to obstacles [m].
        seed: of its random numbers.

    Raises:
        ValueError: an obstacle is of a shape that its scene does not take.
    """
    scene = _scene(robot, problem.obstacles, margin)
    begin = time.thread_time()
    options = RRTOptions(
        'arm', max_nodes=_MOST_NODES, max_connection_distance=_CONNECTION,
        collision_check_step_size=_STEP, max_planning_time=_PATIENCE, rrt_connect=True)
    rrt = RRT(scene, options)
    rrt.setRngSeed(seed)
    names, reason = list(robot.joint_names), ''
    postures = np.array((problem.start, problem.start))  # it stands where it finds no way
    try:
        path = rrt.plan(*(JointConfiguration(names, q) for q in (problem.start, problem.goal)))
        path = PathShortcutter(scene, PathShortcuttingOptions(
            'arm', max_step_size=_STEP, max_iters=_SHORTCUTS, seed=seed)).shortcut(path)
        found = PathParameterizerTOPPRA(scene, 'arm').generate(path, TOPPRAOptions(
            DT, SplineFittingMode.Adaptive, max_adaptive_step_size=_STEP))
        postures = np.array(found.positions)
    except RuntimeError as error:
        reason = str(error)
    took = time.thread_time() - begin
    return Run(postures, np.diff(postures, axis=0) / DT, np.array([1e6 * took]), not reason,
               reason)


def _scene(robot: Robot, obstacles: Sequence[Obstacle], margin: float) -> Scene:
    """Return arm and obstacles, of which only pairs that shall not meet are checked."""
    own = 0.5 * PlannerParameters().clearance_self_margin
    with tempfile.TemporaryDirectory() as folder:
        model, limits = Path(folder) / 'arm.xml', Path(folder) / 'limits.yaml'
        model.write_text(mjcf(robot, (), margin - own, margin))
        limits.write_text(_limits(robot))
        scene = Scene('arm', loadMjcfModel(model))
        scene.importJointLimitsFromConfig(loadJointLimitsConfig(limits))
    links = range(len(robot.capsules))
    bodies = [f'{kind}{i}' for kind in ('link', 'own') for i in links]
    pairs = [(f'own{i}', f'own{j}') for i, j in robot.self_pairs.tolist()]
    around = [name for i, obstacle in enumerate(obstacles)
              for name in _added(scene, f'obstacle{i}', obstacle)]
    scene.setCollisions(list(combinations(bodies + around, 2)), False)
    pairs += [(f'link{i}', name) for i in compress(links, robot.moved) for name in around]
    scene.setCollisions(pairs, True)
    scene.addGroup('arm', list(robot.joint_names))
    return scene


def _added(scene: Scene, name: str, obstacle: Obstacle) -> list[str]:
    """Add an obstacle's shapes; return their names."""
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = obstacle.rotation, obstacle.center
    x, y, z = obstacle.half_extents.tolist()
    if obstacle.shape == BOX:
        scene.addBoxGeometry(name, 'universe', Box(2.0 * x, 2.0 * y, 2.0 * z), place, _GRAY)
        return [name]
    if obstacle.shape == ELLIPSOID and x == y == z:
        scene.addSphereGeometry(name, 'universe', Sphere(x), place, _GRAY)
        return [name]
    if obstacle.shape not in (CYLINDER, CAPSULE):
        raise ValueError(f"RoboPlan's scene takes no shape like that of '{obstacle.name}': it has "
                         'boxes, cylinders and balls')
    half, names = z - x if obstacle.shape == CAPSULE else z, []
    if half > 0.0:
        names.append(name)
        scene.addCylinderGeometry(name, 'universe', Cylinder(x, 2.0 * half), place, _GRAY)
    if obstacle.shape == CAPSULE:
        for side in (-1.0, 1.0):
            names.append(f'{name}_end{side:g}')
            end = place.copy()
            end[:3, 3] += side * half * place[:3, 2]
            scene.addSphereGeometry(names[-1], 'universe', Sphere(x), end, _GRAY)
    return names


def _limits(robot: Robot) -> str:
    """Return the joints' limits as RoboPlan's YAML, within the margins that the planner keeps."""
    margin, lines = PlannerParameters().limits_position_margin, ['joint_limits:']
    for i, name in enumerate(robot.joint_names):
        lines += [f'  {name}:', *(f'    {key}: [{value!r}]' for key, value in (
            ('min_position', float(robot.position_min[i] + margin)),
            ('max_position', float(robot.position_max[i] - margin)),
            ('max_velocity', float(robot.velocity_max[i])),
            ('max_acceleration', float(robot.acceleration_max[i])),
            ('max_jerk', _ANY)))]
    return '\n'.join(lines) + '\n'

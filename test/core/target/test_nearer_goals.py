"""A goal posture comes nearer along its null space: arms and bases move no more than they must."""

from __future__ import annotations

from conftest import examples, make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from hypothesis import given, settings, strategies as st
import numpy as np

from redundant_planner.core.constants import gains_of, limits_of, robot_constants
from redundant_planner.core.horizon.least_norm_path import path_joints
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.free_space import FreeSpace
from redundant_planner.core.target.goal_postures import nearer, off_poses
from redundant_planner.core.target.inverse_kinematics import self_motion
from redundant_planner.core.target.progress import TargetState
from redundant_planner.io.robot_files import load_robot

PANDA, DT = make_panda(), 0.004
ON_A_BASE = load_robot(ROBOTS / 'panda.yaml', urdf=str(PANDA_URDF), base='holonomic')


def space_of(robot, obstacles=()):
    p = PlannerParameters()
    constants = robot_constants(robot, p)
    joints = path_joints(constants, gains_of(p), limits_of(robot, p))
    radii = [c.radius + p.clearance_margin for c in robot.capsules]
    return FreeSpace(robot, constants, joints, inflated_obstacles(Scene.of(obstacles), radii))


@settings(max_examples=examples(30), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), robot=st.sampled_from([PANDA, ON_A_BASE]))
def test_it_keeps_the_pose_and_no_way_along_the_null_space_leads_nearer(seed, robot):
    random, space = np.random.default_rng(seed), space_of(robot)
    low, high = (np.clip(bound, -3.0, 3.0) for bound in (
        space.joints.position_min, space.joints.position_max))
    q, to = random.uniform(low, high), random.uniform(low, high)
    poses = robot.kinematics(q).tips
    *before, found = nearer(space, q, poses, to)
    assert len(before) < 100
    assert off_poses(robot, found, poses) < 2e-5
    assert (found >= space.joints.position_min).all()
    assert (found <= space.joints.position_max).all()
    best = float(space.distance(found, to))
    assert best <= float(space.distance(q, to)) + 1e-12
    for aside in (to - found, random.normal(size=robot.n), random.normal(size=robot.n)):
        beside, _ = self_motion(found, poses, aside, 0.02, 5, robot.chain, space.joints)
        # A joint at the end of its range turns a step elsewhere than it was to lead.
        inside = (np.abs(beside - space.joints.position_min) > 1e-3).all(axis=1) & (
            np.abs(beside - space.joints.position_max) > 1e-3).all(axis=1)
        gained = best - space.distance(beside[inside], to)
        assert (gained < 0.01 + 0.02 * best).all()


def base_way(away):
    """How far the base goes to a target (3,) [m] away, and if it drove there first [m].

    It would stop half a metre from the target's place, and the arm would reach.
    """
    q = np.concatenate((np.zeros(3), PANDA_READY))
    tip = ON_A_BASE.kinematics(q).tips.first
    target = Pose(tip.position + away, tip.rotation)
    planner, way = Planner(ON_A_BASE), 0.0
    for _ in range(round(15.0 / DT)):
        result = planner.step(q, np.zeros(6), (), DT, target=target)
        q = q + DT * result.dq
        way += DT * float(np.linalg.norm(result.dq[:2]))
        if result.progress.state is TargetState.REACHED:
            break
    assert result.progress.state is TargetState.REACHED
    return way, np.linalg.norm(target.position[:2]) - 0.5


def test_a_base_goes_less_far_than_if_it_drove_first():
    random = np.random.default_rng(0)
    angles, distances, heights = (
        random.uniform(low, high, 10) for low, high in ((-np.pi, np.pi), (1.0, 2.5), (-0.3, 0.3)))
    ways = np.array([
        base_way(np.array((distance * np.cos(angle), distance * np.sin(angle), height)))
        for angle, distance, height in zip(angles, distances, heights)])
    way, driven_first = ways.sum(axis=0)
    assert way < 0.98 * driven_first

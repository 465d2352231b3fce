"""What a user sees of a motion, for tests: motion → number."""

from __future__ import annotations

from closed_loop import DT
import numpy as np

from redundant_planner.core.obstacles.self_collision import link_distances

# Distances are measured in every so manyth tick.
_EVERY = 5


def smallest_distance(motion):
    """Between the arm's capsules and the balls [m]."""
    return _distances(motion).min()


def distance_at_first_evasion(motion):
    """From the balls when null-space motion begins, as the method asks for it [m]."""
    evading = [np.linalg.norm(r.homogeneous) > 1e-3 for r in motion.results[::_EVERY]]
    return _distances(motion)[evading.index(True)]


def _distances(motion):
    smallest = []
    radii = [capsule.radius for capsule in motion.robot.capsules]
    for tick in range(0, len(motion.postures), _EVERY):
        arm = motion.robot.kinematics(motion.postures[tick])
        way = arm.segment_end - arm.segment_start
        length = np.maximum((way * way).sum(axis=1), 1e-12)
        distances = []
        for ball in motion.balls:
            center = ball.at(tick * DT)
            along = np.clip(((center - arm.segment_start) * way).sum(axis=1) / length, 0.0, 1.0)
            nearest = arm.segment_start + along[:, None] * way
            distances.append(np.linalg.norm(nearest - center, axis=1) - radii - ball.radius)
        smallest.append(np.min(distances))
    return np.array(smallest)


def distance_between_links(motion):
    """The smallest between the arm's own capsules [m]."""
    radii = np.array([capsule.radius for capsule in motion.robot.capsules])
    arms = map(motion.robot.kinematics, motion.postures[::_EVERY])
    return min(link_distances(arm.segment_start, arm.segment_end, radii, motion.robot.self_pairs)
               .distance.min() for arm in arms)


def time_lost(motion):
    """Behind the command at the end [s]."""
    return DT * sum(1.0 - result.scale for result in motion.results)


def time_the_first_tip_loses(motion):
    """By how much longer it is behind its command than the second one [s]."""
    return DT * sum(result.tips[1].scale - result.tips[0].scale for result in motion.results)


def off_preferred(motion):
    """How far the third joint is from 0.5 rad in the mean [rad]."""
    return np.abs(motion.postures[:, 2] - 0.5).mean()


def distance_left(motion):
    """To the target at the end [m]."""
    return motion.results[-1].progress.distance


def time_to_the_first_motion(motion):
    """How long the arm stands [s]."""
    moves = np.abs([result.dq for result in motion.results]).max(axis=1) > 1e-3
    return DT * int(moves.argmax())


def effort(motion):
    """The squared joint speed integrated: what the shortest joint path has least of."""
    return DT * sum(result.dq @ result.dq for result in motion.results)


def path_length(motion):
    """The sum of all joints' ways [rad, m]."""
    return np.abs(np.diff(motion.postures, axis=0)).sum()


def way_of_the_first_joint(motion):
    return np.abs(np.diff(motion.postures[:, 0])).sum()


def null_space_share(motion):
    """The largest null-space speed over the least-norm speed."""
    return max(np.linalg.norm(r.homogeneous) / np.linalg.norm(r.least_norm)
               for r in motion.results)


def largest_jump_of_the_null_space(motion):
    """From one tick to the next, once the arm is at speed [rad/s]."""
    speeds = np.array([result.homogeneous for result in motion.results[60:]])
    return np.linalg.norm(np.diff(speeds, axis=0), axis=1).max()


def least_norm_at_the_end(motion):
    """The least joint speed that follows the command where the arm has come to [rad/s]."""
    return np.linalg.norm(motion.results[-1].least_norm)


def fastest_least_norm(motion):
    """The fastest joint motion that the method asks for, before the filter [rad/s]."""
    return max(np.linalg.norm(result.least_norm) for result in motion.results)


def fastest_joint(motion):
    """The fastest joint [rad/s]."""
    return max(np.abs(result.dq).max() for result in motion.results)


def off_mid_range(motion):
    """H_s of Eq. 3 at the end."""
    robot = motion.robot
    middle = 0.5 * (robot.position_min + robot.position_max)
    return (((motion.postures[-1] - middle) / (robot.position_max - robot.position_min))**2).sum()


def room_to_limits(motion):
    """The smallest distance of a joint from its limits at the end [rad, m]."""
    robot, q = motion.robot, motion.postures[-1]
    return min((q - robot.position_min).min(), (robot.position_max - q).min())


def smallest_singular_value(motion):
    return min(np.linalg.svd(motion.robot.kinematics(q).jacobian)[1][-1]
               for q in motion.postures[::_EVERY])


def way_of_the_tip(motion):
    """From its first position to its last [m]."""
    first, last = _first_and_last(motion)
    return np.linalg.norm(last.tip_position - first.tip_position)


def turn_of_the_tip(motion):
    """From its first orientation to its last [rad]."""
    first, last = _first_and_last(motion)
    return np.arccos(np.clip(
        0.5 * (np.trace(first.tip_rotation.T @ last.tip_rotation) - 1.0), -1.0, 1.0))


def _first_and_last(motion):
    return (motion.robot.kinematics(motion.postures[at]) for at in (0, -1))


def largest_path_error(motion):
    """Of the tip's position [m]."""
    return max(np.linalg.norm(result.path_error[:3]) for result in motion.results)

"""The unit of every joint's position."""

from __future__ import annotations

from redundant_planner.analysis.results import Analysis

# Of a joint of which nothing says whether it turns or slides.
UNKNOWN = 'rad or m'


def joint_units(analysis: Analysis) -> tuple[str, ...]:
    """Return 'rad' for every joint that turns and 'm' for one that slides."""
    robot = analysis.robot
    if robot is None:
        return (UNKNOWN,) * len(analysis.joint_names)
    # Pinocchio's joints, without the one that stands for the world.
    return tuple('rad' if joint.shortname().startswith('JointModelR') else 'm'
                 for joint in list(robot.model.joints)[1:])

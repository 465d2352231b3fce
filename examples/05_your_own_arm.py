"""Drive an arm from its URDF: python examples/05_your_own_arm.py my_robot.urdf tool0.

Without arguments it takes the Panda of the PyPI package example-robot-data.
"""

from importlib.metadata import files, PackageNotFoundError
import sys

import numpy as np

from redundant_planner import Obstacle, Planner, PlannerParameters, Robot, Scene, simulate

if len(sys.argv) == 3:
    urdf, tip = sys.argv[1:]
else:
    try:
        urdf = next(f.locate() for f in files('example-robot-data') if f.name == 'panda.urdf')
    except PackageNotFoundError:
        sys.exit('give a URDF and its tip link, or install a Panda: '
                 'pip install example-robot-data')
    tip = 'panda_hand'

# Capsules are fitted to the collision meshes: seconds the first time, then from a cache.
# A URDF has no acceleration limits; ask the maker of your arm [rad/s², m/s²].
robot = Robot.from_urdf(urdf, tip, acceleration_max=5.0)
print(f'{robot.name}: {robot.n} joints from {robot.base_frame} to {robot.tip_frame}')
for capsule in robot.capsules:
    print(f'  {capsule.name}: radius {1000 * capsule.radius:.0f} mm')

# From the middle of the joint ranges, a small circle past a ball beside the tool.
ranges = robot.position_min + robot.position_max
start = np.where(np.isfinite(ranges), 0.5 * ranges, 0.0)
tool = robot.kinematics(start).tip_position
ball = Obstacle('ball', center=tool + [0.0, 0.25, 0.0], semi_axes=[0.05, 0.05, 0.05])


def twist(time):
    """Return the commanded twist at a time [s]."""
    return [0.0, 0.1 * np.sin(2.0 * time), 0.1 * np.cos(2.0 * time), 0.0, 0.0, 0.0]


motion = simulate(Planner(robot, PlannerParameters()), start, twist, Scene.of([ball]), 3.1, 0.004)
print(f'smallest clearance: {1000 * motion.clearance.min():.1f} mm')
print(f'distance off the path: {1000 * np.abs(motion.results[-1].path_error[:3]).max():.3f} mm')

"""A ball flies through the place where the arm is: the arm evades, and the tool stays put."""

import numpy as np

from redundant_planner import Obstacle, Planner, PlannerParameters, Robot, Scene, simulate

robot = Robot.from_file('package://redundant_planner/config/robots/paper_2p5r.yaml')
planner = Planner(robot, PlannerParameters())

# The planner expects an obstacle to go on at its `velocity` [m/s]; `simulate` moves it on.
ball = Obstacle('ball', center=[0.5, 0.6, 0.6], semi_axes=[0.04, 0.04, 0.04],
                velocity=[-0.15, 0.0, 0.0])
start = [0.1, 0.1, 0.0, 0.52, -0.52, 1.05, 0.0]  # [m, rad]
hold = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
motion = simulate(planner, start, hold, Scene.of([ball]), 6.0, 0.004)

tool = np.array([result.pose.position for result in motion.results])
moved = np.abs(motion.positions - motion.positions[0]).max(axis=0)
print(f'smallest clearance: {1000 * motion.clearance.min():.1f} mm')
print(f'the tool moved {1000 * np.linalg.norm(tool - tool[0], axis=1).max():.2f} mm')
for name, distance in zip(robot.joint_names, moved):
    print(f'{name}: up to {distance:.3f}')

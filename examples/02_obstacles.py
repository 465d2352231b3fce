"""Drive the tool into an obstacle on its own path: it slows down, stops and says why."""

import numpy as np

from redundant_planner import Obstacle, Planner, PlannerParameters, Robot, Scene, simulate

robot = Robot.from_file('package://redundant_planner/config/robots/paper_2p5r.yaml')
planner = Planner(robot, PlannerParameters(clearance_margin=0.02))  # [m]

# Ellipsoids in the base frame: centre and semi-axes [m], and a quaternion (x, y, z, w).
scene = Scene.of([
    Obstacle('ball', center=[0.0, 0.55, 0.45], semi_axes=[0.05, 0.03, 0.03]),
    Obstacle('beam', center=[0.0, 0.25, 0.92], semi_axes=[0.3, 0.04, 0.04],
             orientation=[0.0, 0.0, np.sin(0.2), np.cos(0.2)]),
])
start = [0.1, 0.1, 0.0, 0.52, -0.52, 1.05, 0.0]  # [m, rad]
motion = simulate(planner, start, [0.0, -0.05, 0.0, 0.0, 0.0, 0.0], scene, 5.0, 0.004)

# Each tick's StepResult says what it decided: here the share of the commanded speed, and why.
for second in (1, 2, 3, 4):
    tick = round(second / 0.004)
    result = motion.results[tick]
    print(f'{second} s: {result.scale:4.0%} of the speed, '
          f'{1000 * motion.clearance[tick]:.0f} mm clear {result.reason}')
print(f'smallest clearance: {1000 * motion.clearance.min():.1f} mm')
print(f'distance off the path: {1000 * np.abs(motion.results[-1].path_error).max():.3f} mm')

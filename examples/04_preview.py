"""Tell the planner the twists to come: the joints travel less for the same tool motion."""

import numpy as np

from redundant_planner import Obstacle, Planner, PlannerParameters, Preview, Robot, Scene, simulate

robot = Robot.from_file('package://redundant_planner/config/robots/paper_2p5r.yaml')
# The method that plans ahead: the shortest joint path over the next seconds.
planner = Planner(robot, PlannerParameters(method='variational'))
scene = Scene.of([Obstacle('ball', center=[0.0, 0.55, 0.45], semi_axes=[0.05, 0.03, 0.03])])
start = [0.1, 0.1, 0.0, 0.52, -0.52, 1.05, 0.0]  # [m, rad]

# Speed up over 0.5 s, go on, and slow down: the twist is linear between these points.
line = np.array([-0.03, -0.06, 0.0, 0.0, 0.0, 0.0])  # [m/s, rad/s]
preview = Preview([0.0, 0.5, 3.0, 3.5], [0.0 * line, line, line, 0.0 * line])


def twist(time):
    """Return the commanded twist at a time [s]."""
    return preview.at(np.array([time]))[0]


for name, known in (('present twist alone', None), ('twists to come', preview)):
    motion = simulate(planner, start, twist, scene, 3.6, 0.004, known)
    path = np.abs(np.diff(motion.positions, axis=0)).sum()
    squared = np.square(motion.velocities).sum() * 0.004
    print(f'{name:20} joint path {path:.4f}, integral of squared velocities {squared:.5f}, '
          f'smallest clearance {1000 * motion.clearance.min():.1f} mm')

"""Give a pose instead of a twist: the tool goes there by a short way around what is in between."""

import numpy as np

from redundant_planner import Obstacle, Planner, PlannerParameters, Pose, Robot, Scene, TargetState

robot = Robot.from_file('package://redundant_planner/config/robots/paper_2p5r.yaml')
planner = Planner(robot, PlannerParameters())
scene = Scene.of([Obstacle('ball', center=[0.0, 0.55, 0.45], semi_axes=[0.05, 0.03, 0.03])])
q = np.array([0.1, 0.1, 0.0, 0.52, -0.52, 1.05, 0.0])  # [m, rad]
dt, still = 0.004, np.zeros(6)

begin = robot.kinematics(q)
target = Pose(begin.tip_position + [-0.09, -0.15, 0.01], begin.tip_rotation)
# In a straight line instead: PlannerParameters(target_path='straight').
for tick in range(1000):
    # A target that moves is followed: give `step` another one in any tick.
    result = planner.step(q, still, scene, dt, target=target)
    q = q + dt * result.dq
    if tick % 50 == 0:
        progress = result.progress
        print(f'{dt * tick:.1f} s: {progress.state.value:7} {1000 * progress.distance:6.1f} mm, '
              f'another {progress.seconds:.2f} s')
    if result.progress.state is TargetState.REACHED:
        print(f'reached after {dt * tick:.2f} s, off by {1e3 * result.progress.distance:.2f} mm')
        break

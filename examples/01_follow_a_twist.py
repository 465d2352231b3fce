"""Move the tool along a line past an obstacle: every link keeps its distance."""

from redundant_planner import Obstacle, Planner, PlannerParameters, Robot, Scene, simulate

robot = Robot.from_file('package://redundant_planner/config/robots/paper_2p5r.yaml')
planner = Planner(robot, PlannerParameters())
ball = Obstacle('ball', center=[0.0, 0.55, 0.45], semi_axes=[0.05, 0.03, 0.03])  # [m]
start = [0.1, 0.1, 0.0, 0.52, -0.52, 1.05, 0.0]  # [m, rad]
twist = [-0.029, -0.05, 0.004, 0.0, 0.0, 0.0]  # of the tool [m/s, rad/s]
motion = simulate(planner, start, twist, Scene.of([ball]), duration=3.0, dt=0.004)  # [s]
print(f'smallest clearance: {1000 * motion.clearance.min():.1f} mm')

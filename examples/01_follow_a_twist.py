"""Move the hand along a line past an obstacle: every link keeps its distance."""

from redundant_planner import Obstacle, Planner, Robot, simulate

robot = Robot.from_file('panda')  # or Robot.from_urdf('my_arm.urdf', 'tool0')
ball = Obstacle('ball', center=[0.3, 0.3, 0.5], semi_axes=[0.06, 0.06, 0.06])  # [m]
twist = [0.0, 0.15, 0.0, 0.0, 0.0, 0.0]  # of the hand [m/s, rad/s]
motion = simulate(Planner(robot), robot.ready, twist, [ball], duration=3.0, dt=0.004)  # [s]
print(f'smallest clearance: {1000 * motion.clearance.min():.1f} mm')

"""Give the arm rules of your own: a barrier that it keeps, and a criterion for its spare joints.

Each is a function of the arm's kinematics that returns a number and its gradient by the joints.
"""

import numpy as np

from redundant_planner import Barrier, Criterion, Planner, Robot, simulate

robot = Robot.from_file('panda', axes=['vx', 'vy', 'vz'])  # where the hand looks is left to us
column, radius = np.array([0.0, 0.3]), 0.26  # an upright cylinder that the elbow stays out of [m]
part = np.array([0.5, 0.0, 0.2])  # what the camera on the hand looks at [m]


def elbow_outside_column(arm):
    """Return the elbow's distance from the cylinder [m], and how the joints change it."""
    elbow, jacobian = robot.point(arm, 'panda_link4')
    off = elbow[:2] - column
    distance = np.linalg.norm(off)
    return distance - radius, off / distance @ jacobian[:2]


def looks_at_part(arm):
    """Return the cosine between the camera's axis and its line of sight to the part."""
    camera, moving = robot.point(arm, 'panda_hand', offset=[0.05, 0.0, 0.0])
    axis, turning = robot.direction(arm, 'panda_hand', [0.0, 0.0, 1.0])
    distance = np.linalg.norm(part - camera)
    sight = (part - camera) / distance
    cosine = axis @ sight
    return cosine, sight @ turning - (axis - cosine * sight) @ moving / distance


def in_view(arm):
    """Return how far the part is from the edge of the picture, 35° from its middle."""
    cosine, gradient = looks_at_part(arm)
    return cosine - np.cos(np.radians(35.0)), gradient


# Planner compares each gradient with finite differences, and says which entry is wrong.
barriers = [Barrier('elbow outside the column', elbow_outside_column),
            Barrier('the part in view', in_view)]
criteria = [Criterion('look at the part', looks_at_part, weight=5.0)]
twist = [0.0, 0.15, 0.0, 0.0, 0.0, 0.0]  # of the hand [m/s, rad/s]
for name, planner in (('without', Planner(robot)),
                      ('with', Planner(robot, barriers=barriers, criteria=criteria))):
    motion = simulate(planner, robot.ready, twist, [], duration=4.0, dt=0.004)  # [s]
    arms = [robot.kinematics(q) for q in motion.positions]
    moved = arms[-1].tip_position - arms[0].tip_position
    print(f'{name} rules: the hand goes {moved[1]:.2f} m, the elbow keeps '
          f'{1000 * min(elbow_outside_column(arm)[0] for arm in arms):.1f} mm, the part is up to '
          f'{np.degrees(np.arccos(min(looks_at_part(arm)[0] for arm in arms))):.1f}° aside')
print(motion.results[-1].reason)
for own in motion.results[-1].own:
    print(f'{own.name}: {own.value:.4f}')

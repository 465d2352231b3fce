"""Two hands on one body: each goes to a pose, then both hold one object and move it."""

import numpy as np

from redundant_planner import Planner, Pose, Robot, TargetState

HANDS = 'left_hand', 'right_hand'


def arm(side, way):
    """Return the URDF of six joints that hang beside the torso, and of a hand."""
    joints = ((f'0 {0.2 * way} 0.1', '0 1 0'), ('0.05 0 0', '0 0 1'), ('0 0 0', '1 0 0'),
              ('0.28 0 0', '0 1 0'), ('0.25 0 0', '1 0 0'), ('0.06 0 0', '0 1 0'))
    links = ['torso', *(f'{side}_link{i}' for i in range(6)), f'{side}_hand']
    return ''.join(
        f'<link name="{child}"/><joint name="{side}{i}" type="{"revolute" if axis else "fixed"}">'
        f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
        f'<axis xyz="{axis or "1 0 0"}"/>'
        '<limit lower="-2.6" upper="2.8" velocity="2" effort="1"/></joint>'
        for i, (parent, child, (xyz, axis)) in enumerate(
            zip(links, links[1:], (*joints, ('0.1 0 0', '')))))


urdf = f"""<robot name="two_hands"><link name="base"/><link name="torso"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="torso"/>
<origin xyz="0 0 0.6"/><axis xyz="0 0 1"/>
<limit lower="0" upper="0.4" velocity="0.3" effort="1"/></joint>
{arm('left', 1)}{arm('right', -1)}</robot>"""

# Of a file: Robot.from_urdf('my_robot.urdf', tips=HANDS).
robot = Robot(urdf, tips=HANDS, link_radius=0.03)
planner, dt = Planner(robot), 0.004
q = robot.ready


def run_to(target, still):
    """Go to a target; return the seconds that it took."""
    global q
    for tick in range(2000):
        result = planner.step(q, still, [], dt, target=target)
        q = q + dt * result.dq
        if result.progress.state is TargetState.REACHED:
            return dt * tick
    raise SystemExit(f'not reached: {result.reason}')


def hands():
    """Return where both hands are."""
    return robot.kinematics(q).tips.each


# A pose for each hand; the twists (2, 6) of both are zero.
left, right = hands()
seconds = run_to({'left_hand': Pose(left.position + [0.05, 0.0, 0.05], left.rotation),
                  'right_hand': Pose(right.position + [0.0, 0.05, 0.0], right.rotation)},
                 np.zeros((2, 6)))
print(f'both hands are there after {seconds:.2f} s')

# Now they hold one object: one twist (6,), one target. Its frame is half way between the hands.
planner.couple(q=q)
left, right = hands()
apart = right.position - left.position
middle = 0.5 * (left.position + right.position)
seconds = run_to(Pose(middle + [0.0, 0.0, 0.15], np.eye(3)), np.zeros(6))
left, right = hands()
off = np.linalg.norm(right.position - left.position - apart)
print(f'the object rose by {1e3 * (0.5 * (left.position + right.position) - middle)[2]:.1f} mm '
      f'in {seconds:.2f} s; between the hands it moved by {1e3 * off:.3f} mm')

planner.uncouple()
before = hands()
for _ in range(100):
    q = q + dt * planner.step(q, [[0.0, 0.05, 0.0, 0.0, 0.0, 0.0], [0.0] * 6], [], dt).dq
moved = [1e3 * np.linalg.norm(b.position - a.position) for a, b in zip(before, hands())]
print(f'let go: the left hand moves by {moved[0]:.1f} mm, the right one by {moved[1]:.1f} mm')

"""An arm with mass: it stands, falls, follows, and keeps its torque limits."""

from __future__ import annotations

from conftest import make_panda, PANDA_READY
import numpy as np
import pytest

from redundant_planner.core.errors import RobotError
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.physics_parameters import PhysicsParameters
from redundant_planner.physics.arm import PhysicsArm

TICK = 0.004
# A mass of 3 kg, 0.5 m below its joint.
PENDULUM = """
<robot name="pendulum"><link name="base"/>
  <link name="rod"><inertial><origin xyz="0 0 -0.5"/><mass value="3"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/>
    <axis xyz="0 1 0"/><limit effort="{effort}" velocity="2"/></joint>
</robot>"""


def panda_arm(**changes):
    robot = make_panda()
    return PhysicsArm(robot, PhysicsParameters(**changes),
                      dict(zip(robot.joint_names, PANDA_READY)))


def pendulum(start, effort=100, **changes):
    robot = Robot(PENDULUM.format(effort=effort), 'rod', axes=('vx',), capsules=[])
    return PhysicsArm(robot, PhysicsParameters(**changes), {'hinge': start})


def played(arm, velocity, duration, begin=0.0):
    """Command velocities (n,) of time; return the times, positions and velocities of all ticks."""
    arm.advance(begin)
    times, states = [], []
    for i in range(round(duration / TICK)):
        arm.command(begin + i * TICK, velocity(i * TICK))
        arm.advance(begin + (i + 1) * TICK)
        times.append((i + 1) * TICK)
        states.append((arm.q, arm.dq))
    return (np.array(times), *(np.array(part) for part in zip(*states)))


def test_an_arm_whose_weight_is_known_stands_still():
    arm = panda_arm()
    before = arm.q
    arm.advance(0.0)
    arm.advance(1.0)
    assert np.abs(arm.q - before).max() < 1e-9 and np.abs(arm.dq).max() < 1e-9
    # Its drives hold it up: joint 4 carries the forearm.
    assert 15.0 < abs(arm.torques[3]) < 30.0 and arm.contacts.count == 0


@pytest.mark.parametrize('error', [0.2, -0.2])
def test_a_wrong_mass_sags_as_the_stiffness_says(error):
    """The servo compensates the nominal weight w: the rest, error · w, takes (error · w)/k."""
    right, wrong = panda_arm(), panda_arm(mass_error=error)
    for arm in (right, wrong):
        arm.advance(0.0)
        arm.advance(1.0)
    expected = -error * right.torques / wrong.stiffness
    np.testing.assert_allclose(wrong.q - right.q, expected, rtol=0.02, atol=2e-6)
    assert np.abs(wrong.q - right.q).max() > 1e-4


def test_without_a_servo_a_pendulum_swings_with_its_period():
    """T = 2π √(I/(m g l)) for small swings, I = 0.02 + m l²."""
    arm = pendulum(0.05, servo='off', armature=0.0, joint_damping=0.0)
    arm.advance(0.0)
    times = np.arange(1, 4001) * 1e-3
    angles = np.array([(arm.advance(t), arm.q[0])[1] for t in times])
    rising = times[1:][(angles[:-1] < 0.0) & (angles[1:] >= 0.0)]
    period = 2.0 * np.pi * np.sqrt((0.02 + 3.0 * 0.25) / (3.0 * 9.81 * 0.5))
    assert np.diff(rising).mean() == pytest.approx(period, rel=2e-3)
    # It loses no energy, nor gains any: every swing is as wide.
    assert np.abs(angles).max() < 0.051 and np.abs(angles[-1500:]).max() > 0.049
    np.testing.assert_array_equal(arm.torques, 0.0)


def test_gravity_may_come_from_anywhere():
    arm = pendulum(0.05, servo='off', gravity=(0.0, 0.0, 9.81))
    arm.advance(0.0)
    arm.advance(1.0)
    assert abs(arm.q[0]) > 0.8


def test_a_velocity_profile_is_followed_closely():
    arm = panda_arm()
    start = arm.q
    peak = np.array([0.6, -0.3, 0.4, 0.5, -0.6, 0.5, 0.8, 0.0])
    times, q, dq = played(arm, lambda t: np.sin(np.pi * t / 2.0) ** 2 * peak, 2.0)
    # ∫ sin² of the commands, which each hold for a tick.
    sums = np.cumsum(np.sin(np.pi * (times - TICK) / 2.0) ** 2) * TICK
    assert np.abs(q - start - np.outer(sums, peak)).max() < 1e-3
    assert np.abs(dq - np.outer(np.sin(np.pi * times / 2.0) ** 2, peak)).max() < 0.03
    assert 0.1 < arm.largest_demand.max() < 0.6


def test_a_position_servo_goes_where_it_is_told():
    arm = panda_arm(servo='position')
    start, goal = arm.q, arm.q
    goal[0] += 0.05
    arm.advance(0.0)
    for i in range(250):
        arm.command(i * TICK, np.zeros(8), np.append(goal[:7], np.nan))
        arm.advance((i + 1) * TICK)
    np.testing.assert_allclose(arm.q, goal, atol=2e-5)
    assert arm.q[7] == pytest.approx(start[7], abs=1e-5)


def test_torque_limits_are_kept_and_told():
    """The weight at 90 degrees, 14.7 Nm, is more than the drive has: it falls."""
    arm = pendulum(np.pi / 2.0, effort=10)
    arm.advance(0.0)
    torques = [(arm.advance(0.01 * i), arm.torques[0])[1] for i in range(1, 200)]
    assert np.abs(torques).max() <= 10.0 and arm.largest_demand[0] > 1.2
    assert arm.q[0] < 1.2
    strong = pendulum(np.pi / 2.0, effort=40)
    strong.advance(0.0)
    strong.advance(2.0)
    assert strong.q[0] == pytest.approx(np.pi / 2.0, abs=1e-6)


def test_a_reference_does_not_run_away_from_an_arm_that_cannot_follow():
    arm = pendulum(0.0, effort=5)
    played(arm, lambda t: np.array([1.0]), 2.0)  # blocked by its weight
    stuck = arm.q[0]
    assert stuck < 1.0
    # Told to go back, it does so at once.
    _, q, _ = played(arm, lambda t: np.array([-1.0]), 0.2, begin=2.0)
    assert q[-1, 0] < stuck - 0.1


def test_without_commands_it_brakes_and_holds():
    arm = panda_arm(command_timeout=0.05)
    speed = np.zeros(8)
    speed[0] = 0.5
    played(arm, lambda t: speed * min(t / 0.2, 1.0), 0.4)
    assert arm.dq[0] == pytest.approx(0.5, abs=0.01)
    at_timeout = arm.q[0]
    arm.advance(0.8)
    # 50 ms less the last period at 0.5 rad/s.
    assert arm.q[0] - at_timeout == pytest.approx(0.5 * (0.05 - TICK), abs=3e-3)
    assert abs(arm.dq[0]) < 1e-4


def test_commands_wait_for_the_dead_time_and_keep_the_urdfs_speed():
    arm = panda_arm(lag=0.1)
    start = arm.q
    arm.advance(0.0)
    for i in range(25):
        arm.command(i * TICK, np.array([9.0, *[0.0] * 7]))
        arm.advance((i + 1) * TICK)
    np.testing.assert_allclose(arm.q, start, atol=1e-9)
    for i in range(25, 75):
        arm.command(i * TICK, np.array([9.0, *[0.0] * 7]))
        arm.advance((i + 1) * TICK)
    assert arm.dq[0] == pytest.approx(arm.ranges.velocity_max[0], rel=0.01)


def test_it_stops_at_its_position_limits():
    arm = panda_arm()
    _, q, _ = played(arm, lambda t: np.append(np.zeros(7), 0.1), 1.0)
    assert q[-1, 7] == pytest.approx(0.04, abs=1e-3)
    assert (q[:, 7] < 0.042).all()


def test_fingers_that_mimic_close_together():
    arm = panda_arm()
    played(arm, lambda t: np.append(np.zeros(7), 0.02), 1.0)
    follower = arm.data.joint('panda_finger_joint2').qpos[0]
    assert arm.q[7] == pytest.approx(0.02, abs=1e-3)
    assert follower == pytest.approx(arm.q[7], abs=1e-3)


def test_time_that_is_skipped_or_goes_backwards_moves_nothing():
    arm = panda_arm()
    arm.advance(0.0)
    arm.command(0.0, np.full(8, 0.1))
    arm.skip_to(10.0)
    arm.advance(5.0)
    assert arm.steps == 0
    arm.advance(10.1)
    assert arm.steps == pytest.approx(100, abs=1) and np.abs(arm.dq).max() < 1e-6


def test_a_start_posture_is_checked():
    with pytest.raises(RobotError, match="unknown joint 'elbow'"):
        PhysicsArm(make_panda(), PhysicsParameters(), {'elbow': 0.0})

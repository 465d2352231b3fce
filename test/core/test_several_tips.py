"""Bodies with several tips: each goes its own way, or both hold one object."""

from __future__ import annotations

from conftest import examples, HANDS, make_panda, make_two_handed, random_postures
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.commands import Commands
from redundant_planner.core.errors import ParameterError, RobotError, StateError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.parameters import AXES, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.redundancy.coupling import Coupling
from redundant_planner.core.robot.se3 import integrate, Pose, pose_error, poses_error
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.core.target.progress import TargetState
from redundant_planner.core.target.smooth_curve import SmoothCurve

BODY = make_two_handed()
DT = 0.004
# Both elbows bent, the hands in front.
START = np.array([0.2, 0.0, 0.4, 0.3, 0.2, 0.9, 0.1, 0.4, 0.4, -0.3, -0.2, 0.9, -0.1, 0.4])
SEEDS = st.integers(0, 2**32 - 1)


def twists(left=(), right=()):
    found = np.zeros((2, 6))
    found[0, :len(left)], found[1, :len(right)] = left, right
    return found


def relative(robot, q):
    """The right hand's pose in the left one's frame, as (12,) numbers."""
    (left, right) = robot.kinematics(q).tips.each
    return np.concatenate((left.rotation.T @ (right.position - left.position),
                           (left.rotation.T @ right.rotation).ravel()))


def test_the_joints_are_those_that_move_a_tip():
    assert BODY.n == 14 and BODY.m == 12 and BODY.tips == HANDS
    assert BODY.joint_names[:2] == ('lift', 'waist')
    one = make_two_handed(tips=HANDS[1:])
    assert one.n == 8 and one.m == 6
    alone = make_two_handed(tips=(), link_radius=0.03, capsules=None, **{'tip_frame': HANDS[1]})
    assert alone.joint_names == one.joint_names


def test_arms_of_one_body_can_collide_with_each_other():
    names = [capsule.name for capsule in BODY.capsules]
    pairs = {frozenset((names[a], names[b])) for a, b in BODY.self_pairs}
    assert frozenset(('left6_link', 'right6_link')) in pairs
    # Both shoulders hang on the torso, and are neighbours of it and not of each other.
    assert frozenset(('waist_link', 'left1_link')) not in pairs


@given(SEEDS)
def test_distances_between_the_arms_change_no_faster_than_their_bounds(seed):
    random = np.random.default_rng(seed)
    q = random.uniform(BODY.position_min, BODY.position_max)
    motion = random.uniform(-1e-3, 1e-3, BODY.n)
    radii = np.zeros(len(BODY.capsules))
    here, there = (link_distances(arm.segment_start, arm.segment_end, radii, BODY.self_pairs)
                   for arm in map(BODY.kinematics, (q, q + motion)))
    supports = np.abs(BODY.supports[BODY.self_pairs[:, 0]] - BODY.supports[BODY.self_pairs[:, 1]])
    bounds = (supports * BODY.lever_arm_bounds[BODY.self_pairs].max(axis=1)) @ np.abs(motion)
    assert (np.abs(there.distance - here.distance) <= bounds + 1e-12).all()


@pytest.mark.parametrize(('options', 'message'), [
    ({'tips': ('left_hand', 'left_hand')}, 'several different ones'),
    ({'tips': ('left_hand', 'claw')}, "tip_frame 'claw' is not in the URDF"),
    ({'axes': {'left_hand': AXES}}, "axes are given for 'left_hand'"),
    ({'tip_frame': 'left_hand'}, 'one of them names the end effector'),
])
def test_tips_that_make_no_body_are_refused(options, message):
    with pytest.raises(RobotError, match=message):
        make_two_handed(**options)


@given(SEEDS)
@settings(max_examples=examples(60))
def test_each_tip_follows_its_own_twist_and_null_space_motion_moves_neither(seed):
    random = np.random.default_rng(seed)
    robot = make_two_handed(jerk_max=np.inf)
    planner, q = Planner(robot), START
    command = twists(random.uniform(-0.05, 0.05, 6), random.uniform(-0.05, 0.05, 6))
    due = list(BODY.kinematics(q).tips.each)
    for _ in range(50):
        result = planner.step(q, command, [], DT)
        assert np.abs(robot.kinematics(q).jacobian @ result.homogeneous).max() < 1e-9
        q = q + DT * result.dq
        due = [integrate(pose, tip.scale * twist, DT, False)
               for pose, twist, tip in zip(due, command, result.tips)]
    if result.stage is Stage.DESIRED:
        for tip, pose in zip(BODY.kinematics(q).tips.each, due):
            assert np.abs(pose_error(pose, tip, False)).max() < 1e-5


def test_what_is_in_one_hands_way_does_not_stop_the_other():
    planner, q = Planner(BODY), START
    hands = BODY.kinematics(q).tip_positions
    ahead = hands[0] + (0.16, 0.0, 0.0)
    wall = Obstacle.box('wall', ahead, (0.02, 0.3, 0.3))
    for _ in range(400):
        result = planner.step(q, twists((0.1,), (0.0, 0.0, 0.03)), [wall], DT)
        q = q + DT * result.dq
    left, right = BODY.kinematics(q).tip_positions - hands
    assert result.tips[0].scale < 0.1 and left[0] < 0.13
    assert right[2] > 0.9 * 0.03 * 400 * DT and np.abs(right[:2]).max() < 1e-3


def test_a_hand_that_is_held_up_for_long_does_not_slow_the_other():
    planner, q = Planner(BODY), START
    wall = Obstacle.box(
        'wall', BODY.kinematics(q).tip_positions[0] + (0.16, 0.0, 0.0), (0.02, 0.3, 0.3))
    shares = []
    for tick in range(1600):  # 4 s of them in front of the wall
        up = 0.03 if tick // 400 % 2 == 0 else -0.03
        result = planner.step(q, twists((0.1,), (0.0, 0.0, up)), [wall], DT)
        q = q + DT * result.dq
        shares.append([tip.scale for tip in result.tips])
    left, right = np.mean(shares[600:], axis=0)
    assert left < 0.05 and right > 0.95


@pytest.mark.parametrize('order', [HANDS[:1], HANDS, HANDS[1:], HANDS[::-1]])
def test_the_tip_that_comes_first_goes_on_where_both_cannot(order):
    planner, q = Planner(BODY, PlannerParameters(tip_order=order)), START
    apart = np.subtract(*BODY.kinematics(q).tip_positions)
    towards = 0.1 * apart / np.linalg.norm(apart)
    shares = []
    for _ in range(900):
        result = planner.step(q, twists(-towards, towards), [], DT)
        q = q + DT * result.dq
        shares.append([tip.scale for tip in result.tips])
    first, second = np.array(shares).T[::1 if order[0] == HANDS[0] else -1]
    hindered = first + second < 1.98
    assert hindered.sum() > 50
    assert first[hindered].mean() > second[hindered].mean() + 0.2


@pytest.mark.parametrize('order', [('claw',), ('left_hand', 'left_hand')])
def test_an_order_of_other_tips_is_refused(order):
    planner = Planner(BODY)
    with pytest.raises(ParameterError, match=r"'tip_order' is .*; it takes tips of .*left_hand"):
        planner.parameters = PlannerParameters(tip_order=order)
    assert planner.parameters.tip_order == ()


def test_the_share_that_slow_down_leaves_is_each_tips_own():
    robot = make_two_handed(jerk_max=np.inf)
    planner = Planner(robot, PlannerParameters(slow_down=('person=0.2:6.0',)))
    q, command = START, twists((0.0, 0.05), (0.0, -0.05))
    person = Obstacle('person', robot.kinematics(q).tip_positions.mean(axis=0) + (0.35, 0.0, 0.0),
                      np.full(3, 0.03))
    for _ in range(200):
        result = planner.step(q, command, [person], DT)
        q = q + DT * result.dq
        for tip in result.tips:
            assert np.abs(tip.path_error).max() < 1e-3
    assert 0.0 < result.scale < 0.9


def run_to(planner, q, target, seconds, obstacles=(), twist=None):
    twist = np.zeros((len(planner.robot.tips), 6)) if twist is None else twist
    states = []
    for _ in range(round(seconds / DT)):
        result = planner.step(q, twist, obstacles, DT, target=target)
        q = q + DT * result.dq
        states.append(result.progress.state)
        if states[-1] is TargetState.REACHED:
            break
    return q, states


@pytest.mark.parametrize('path', ['free', 'straight'])
def test_both_tips_get_to_their_targets_together(path):
    planner = Planner(BODY, PlannerParameters(target_path=path))
    goal = START + np.array([0.1, 0.2, *np.full(6, 0.2), *np.full(6, -0.15)])
    poses = BODY.kinematics(goal).tips
    q, states = run_to(planner, START, dict(zip(HANDS, poses.each)), 10.0)
    assert states[-1] is TargetState.REACHED
    assert np.abs(poses_error(poses, BODY.kinematics(q).tips, False)).max() < 1e-3


def test_a_tip_that_has_no_target_stays_where_it_is():
    planner, before = Planner(BODY), BODY.kinematics(START).tips.each
    there = Pose(before[0].position + (0.0, 0.1, 0.1), before[0].rotation)
    q, states = run_to(planner, START, {'left_hand': there}, 10.0)
    after = BODY.kinematics(q).tips.each
    assert states[-1] is TargetState.REACHED
    assert np.abs(pose_error(there, after[0], False)).max() < 1e-3
    assert np.abs(pose_error(before[1], after[1], False)).max() < 1e-3


def test_a_stream_for_one_tip_is_followed_without_thinking():
    planner, q, off = Planner(BODY), START, []
    hand = BODY.kinematics(q).tips.each[1]
    for tick in range(500):
        news, t = [], tick * DT
        if tick % 8 == 0:  # 31 Hz
            at = Pose(hand.position + 0.05 * np.array((0.0, 1.0 - np.cos(3 * t), np.sin(3 * t))),
                      hand.rotation)
            target = {'right_hand': at}
            news = [Sighting(target)]
        result = planner.step(q, twists(), [], DT, target=target, news=news)
        q = q + DT * result.dq
        assert tick < 20 or result.progress.state is not TargetState.THINKING
        off.append(np.linalg.norm(BODY.kinematics(q).tip_positions[1] - at.position))
    assert max(off[200:]) < 0.15 * 0.1 + 0.008  # its speed, for a lag of 0.1 s


def test_one_tip_goes_to_its_target_while_a_twist_moves_the_other():
    planner, q, before = Planner(BODY), START, BODY.kinematics(START).tips.each
    there = Pose(before[0].position + (0.0, 0.05, 0.05), before[0].rotation)
    target = {'left_hand': there, 'right_hand': None}
    for tick in range(750):
        twist = twists((9.0,), (0.0, 0.0, 0.04 if tick < 500 else 0.0))
        result = planner.step(q, twist, [], DT, target=target)
        q = q + DT * result.dq
    after = BODY.kinematics(q).tips.each
    assert np.abs(pose_error(there, after[0], False)).max() < 1e-3
    moved = after[1].position - before[1].position
    assert abs(moved[2] - 0.04 * 500 * DT) < 2e-3 and np.abs(moved[:2]).max() < 1e-3


def test_joint_targets_are_for_the_whole_body():
    goal = START + 0.15
    q, states = run_to(Planner(BODY), START, goal, 5.0)
    assert states[-1] is TargetState.REACHED and np.abs(q - goal).max() < 1e-3


@pytest.mark.parametrize(('twist', 'target', 'message'), [
    (np.zeros(6), None, r'an arm with 2 tips takes \(2, 6\)'),
    (twists(), Pose(np.zeros(3), np.eye(3)), 'say of which tip'),
    (twists(), {'claw': Pose(np.zeros(3), np.eye(3))}, "there are targets for 'claw'"),
    (twists(), {'left_hand': Pose(np.full(3, np.nan), np.eye(3))}, 'three finite'),
    (twists(), Chunk([1.0], [Pose(np.zeros(3), np.eye(3))]), 'one chunk; say of which tip'),
    (twists(), {'left_hand': Chunk([1.0], [START])}, 'give it for the whole body'),
])
def test_bad_commands_are_refused_and_nothing_is_lost(twist, target, message):
    planner = Planner(BODY)
    with pytest.raises(StateError, match=message):
        planner.step(START, twist, [], DT, target=target)
    assert planner.step(START, twists((0.1,)), [], DT).dq.any()


def along(pose, twist, seconds=2.0, points=21):
    """A chunk that begins and ends at rest, and the pose that it ends at."""
    times = np.linspace(0.0, seconds, points)
    shares = 0.5 - 0.5 * np.cos(np.pi * times / seconds)
    poses = [integrate(pose, np.array(twist), share, False) for share in shares]
    return Chunk(times, poses), poses[-1]


LEFT_WAY, RIGHT_WAY = (0.1, 0.05, -0.08, 0.0, 0.3, 0.0), (0.05, -0.1, 0.08, 0.2, 0.0, 0.0)


def ride(planner, target, command, seconds=2.6, things=()):
    """Let hands go along chunks; return the postures, and the last result."""
    postures = [START]
    for _ in range(round(seconds / DT)):
        result = planner.step(postures[-1], command, things, DT, target=target)
        postures.append(postures[-1] + DT * result.dq)
    return np.array(postures), result


def test_each_tip_follows_a_chunk_of_its_own():
    left, right = BODY.kinematics(START).tips.each
    chunks = {HANDS[0]: along(left, LEFT_WAY), HANDS[1]: along(right, RIGHT_WAY, 1.5)}
    postures, result = ride(
        Planner(BODY), {tip: chunk for tip, (chunk, _) in chunks.items()}, twists())
    assert result.progress.state is TargetState.REACHED and result.progress.behind < 0.1
    for tip, (_, end) in zip(BODY.kinematics(postures[-1]).tips.each, chunks.values()):
        assert np.abs(pose_error(end, tip, False)).max() < 1e-3
    # Each is where its own chunk has it.
    for t, (chunk, _) in enumerate(chunks.values()):
        curve = SmoothCurve(chunk.times, np.array([pose.position for pose in chunk.points]))
        due = curve.at(np.array([0.7])).position[0]
        tip = BODY.kinematics(postures[round(0.7 / DT)]).tip_positions[t]
        assert np.abs(tip - due).max() < 3e-3


def test_a_chunk_of_one_hand_goes_on_while_a_twist_moves_the_other():
    left, right = BODY.kinematics(START).tips.each
    chunk, end = along(left, LEFT_WAY)
    postures, result = ride(
        Planner(BODY), {HANDS[0]: chunk}, twists((), (0.0, 0.0, -0.03)))
    there = BODY.kinematics(postures[-1]).tips.each
    assert np.abs(pose_error(end, there[0], False)).max() < 1e-3
    moved = there[1].position - right.position
    assert abs(moved[2] + 0.03 * 2.6) < 3e-3 and np.abs(moved[:2]).max() < 1e-3
    assert result.progress.state is TargetState.REACHED


def test_what_is_in_the_way_of_one_chunk_does_not_delay_the_other():
    left, right = BODY.kinematics(START).tips.each
    targets = {HANDS[0]: along(left, (0.3, 0.0, 0.0, 0.0, 0.0, 0.0))[0],
               HANDS[1]: along(right, RIGHT_WAY)[0]}
    wall = Obstacle.box('wall', left.position + (0.2, 0.0, 0.0), (0.02, 0.3, 0.3))
    postures, result = ride(Planner(BODY), targets, twists(), 4.0, [wall])
    tips = BODY.kinematics(postures[-1]).tips.each
    assert tips[0].position[0] < left.position[0] + 0.19
    assert np.abs(pose_error(targets[HANDS[1]].end, tips[1], False)).max() < 1e-3
    assert result.progress.state is TargetState.BLOCKED and result.progress.behind > 0.5


def test_an_object_follows_a_chunk():
    planner = coupled()
    held = planner.coupling.object_pose(planner.reference)
    chunk, end = along(held, (0.08, 0.05, 0.1, 0.0, 0.2, 0.1))
    postures, result = ride(planner, chunk, np.zeros(6))
    assert result.progress.state is TargetState.REACHED
    there = planner.coupling.object_pose(BODY.kinematics(postures[-1]).tips.first)
    assert np.abs(pose_error(end, there, False)).max() < 1e-3
    before = relative(BODY, START)
    assert max(np.abs(relative(BODY, q) - before).max() for q in postures[::5]) < 2e-4


def coupled(q=START, **options):
    planner = Planner(make_two_handed(**options) if options else BODY)
    planner.step(q, twists(), [], DT)
    planner.couple()
    return planner


@given(SEEDS)
@settings(max_examples=examples(40))
def test_what_both_hands_hold_stays_between_them(seed):
    # In one of some hundred motions a hard stop at a limit costs a millimetre.
    assert lost_of_what_is_held(seed, pushed=False) < 5e-3


def test_what_both_hands_hold_is_lost_by_less_than_a_fifth_of_a_millimetre():
    for seed in range(20):
        assert lost_of_what_is_held(seed, pushed=bool(seed % 2)) < 2e-4


def lost_of_what_is_held(seed, *, pushed):
    """How far the hands' relative pose is lost in a motion, perhaps past a ball [m, rad]."""
    random = np.random.default_rng(seed)
    planner, q = coupled(), START
    command = np.concatenate((random.uniform(-0.15, 0.15, 3), random.uniform(-0.4, 0.4, 3)))
    held = planner.coupling.object_pose(planner.reference)
    moving = Obstacle('ball', held.position + (0.5, 0.0, 0.4), np.full(3, 0.08),
                             velocity=(-0.3, 0.0, -0.2)) if pushed else None
    before, lost = relative(BODY, q), 0.0
    for tick in range(300):
        things = [] if moving is None else [moving.after(tick * DT)]
        q = q + DT * planner.step(q, command, things, DT).dq
        lost = max(lost, np.abs(relative(BODY, q) - before).max())
    return lost


@pytest.mark.parametrize('frame', ['base', 'tool'])
def test_the_object_moves_as_it_is_told(frame):
    planner = coupled(command_frame=frame, jerk_max=np.inf)
    robot, q = planner.robot, START
    expected = planner.coupling.object_pose(planner.reference)
    command = np.array([0.03, 0.02, -0.03, 0.1, -0.1, 0.15])
    for _ in range(200):
        result = planner.step(q, command, [], DT)
        q = q + DT * result.dq
        expected = integrate(expected, result.scale * command, DT, frame == 'tool')
    assert result.scale == 1.0
    end = planner.coupling.object_pose(robot.kinematics(q).tips.first)
    assert np.abs(pose_error(expected, end, False)).max() < 1e-4


def test_an_object_goes_to_its_target_and_can_be_let_go():
    planner = coupled()
    held = planner.coupling.object_pose(planner.reference)
    target = integrate(held, np.array([0.05, 0.0, 0.1, 0.0, 0.2, 0.0]), 1.0, False)
    q, states = run_to(planner, START, target, 8.0, twist=np.zeros(6))
    assert states[-1] is TargetState.REACHED
    assert np.abs(relative(BODY, q) - relative(BODY, START)).max() < 2e-4
    planner.uncouple()
    before = BODY.kinematics(q).tip_positions
    for _ in range(100):
        q = q + DT * planner.step(q, twists((0.0, 0.05)), [], DT).dq
    moved = BODY.kinematics(q).tip_positions - before
    assert moved[0, 1] > 0.01 and np.abs(moved[1]).max() < 3e-4


def test_targets_of_an_object_are_as_old_as_they_were_sent():
    commands, held = Commands(BODY), Pose(np.array([0.5, 0.0, 0.8]), np.eye(3))
    commands.couple(BODY.kinematics(START).tips, held)
    for age in (None, 0.0, 0.03):
        seen, = commands.checked(np.zeros(6), held, [Sighting(held, age)], (1.0, 1.0)).news
        assert seen.age == age


def test_what_cannot_be_coupled_says_so():
    with pytest.raises(StateError, match='takes two tips with six axes each'):
        Planner(make_panda()).couple()
    with pytest.raises(StateError, match='before a tick has told where they are'):
        Planner(BODY).couple()
    planner = coupled()
    with pytest.raises(StateError, match='a pose of their object'):
        planner.step(START, np.zeros(6), [], DT, target=START)


def test_rows_of_a_coupling_are_the_rates_of_relative_poses():
    for q in random_postures(BODY, 20):
        arm = BODY.kinematics(q)
        coupling, dq = Coupling.of(arm.tips), np.random.default_rng(1).normal(size=BODY.n)
        step = 1e-6
        off = [poses_error(coupling.tips(there.tips.first), there.tips, False)[6:]
               for there in (BODY.kinematics(q + way * step * dq) for way in (1, -1))]
        rate = -(off[0] - off[1]) / (2.0 * step)
        np.testing.assert_allclose(coupling.rows(arm) @ dq, rate, atol=1e-6)


def test_runs_of_several_tips_repeat_to_the_last_bit():
    def run():
        planner, q, found = Planner(BODY), START, []
        hand = BODY.kinematics(q).tip_positions[0]
        ball = Obstacle('ball', hand + (0.2, 0.1, 0.0), np.full(3, 0.06))
        goal = dict(zip(HANDS, BODY.kinematics(START + 0.2).tips.each))
        for tick in range(200):
            result = planner.step(
                q, twists((0.05, 0.02), (0.0, -0.05)), [ball], DT,
                target=goal if tick > 100 else None)
            q = q + DT * result.dq
            found.append(result.dq)
        return np.array(found)

    np.testing.assert_array_equal(run(), run())


def bar_between_the_hands():
    """A rod from one hand to the other at `START`, in the first one's frame."""
    left, right = BODY.kinematics(START).tips.each
    way = left.rotation.T @ (right.position - left.position)
    half = 0.5 * np.linalg.norm(way)
    # The shortest turn of the z axis onto the way.
    axis = np.cross((0.0, 0.0, 1.0), way / (2.0 * half))
    turn = np.array([*axis, 1.0 + way[2] / (2.0 * half)])
    return Obstacle.capsule('bar', 0.5 * way, 0.02, 2.0 * half,
                            orientation=turn / np.linalg.norm(turn))


@pytest.mark.parametrize('first', ['hold', 'couple'])
def test_what_both_hands_hold_may_touch_both(first):
    bar, planner = bar_between_the_hands(), Planner(BODY)
    if first == 'hold':
        planner.hold([bar])
    planner.couple(q=START)
    if first == 'couple':
        planner.hold([bar])

    def kept_from(robot):
        """The joints whose links the bar is kept from."""
        held = len(robot.capsules) - 1
        return {int(robot.chain.capsule_joint[i]) for i, j in robot.self_pairs if j == held}

    joints = {name: 1 + BODY.joint_names.index(name) for name in ('left6', 'right6')}
    assert kept_from(planner.robot) and not kept_from(planner.robot) & set(joints.values())
    _, right = BODY.kinematics(START).tips.each
    held = planner.robot.kinematics(START).segment_end[-1]
    np.testing.assert_allclose(held, right.position, atol=1e-9)
    q = START.copy()
    for _ in range(100):
        result = planner.step(q, np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]), (), DT)
        q = q + DT * result.dq
    assert result.scale == 1.0 and q[0] != START[0]
    # One hand alone holds it again, and keeps it from the other.
    planner.uncouple()
    assert planner.robot.held == (bar,)
    assert joints['right6'] in kept_from(planner.robot)
    assert joints['left6'] not in kept_from(planner.robot)

"""When the arm may move: properties of the decision, with time passed in as numbers."""

from __future__ import annotations

import ast
from pathlib import Path

from hypothesis import assume, given, strategies as st
import numpy as np
import pytest

from redundant_planner.nodes import supervisor
from redundant_planner.nodes.supervisor import (
    Decision,
    LISTENING,
    LONGEST_GAP,
    MOVED_BY_OTHERS,
    PAUSED_ALREADY,
    Supervisor,
)

FASTEST, TOLERANCE, TIMEOUT, PERIOD = np.array([1.0, 2.0]), 0.1, 0.1, 0.004
HOME = np.array([0.3, -0.2])
START = 50.0


class Loop:
    """A supervisor in a loop with an arm that stands where it is told."""

    def __init__(self):
        self.supervisor = Supervisor(FASTEST, TOLERANCE)
        self.now, self.at_rest, self.posture = START, True, HOME
        self.decision = Decision()

    def tick(self, seconds=PERIOD, *, measured=True):
        """Let time pass to the next tick, in which the arm obeys at once."""
        self.now += seconds
        if measured:
            self.supervisor.measured(self.posture, self.now)
        self.decision = self.supervisor.decide(self.now, self.at_rest, TIMEOUT)
        self.at_rest = bool(self.decision.hold)
        return self.decision

    def ticks(self, seconds, **options):
        """Tick for a while; the last decision."""
        for _ in range(round(seconds / PERIOD)):
            self.tick(**options)
        return self.decision


@pytest.fixture
def loop():
    """One that has just let the arm move."""
    made = Loop()
    while made.tick().hold:
        assert made.now < START + 2.0 * LISTENING
    return made


def test_it_knows_no_ros_and_no_clock():
    tree = ast.parse(Path(supervisor.__file__).read_text())
    named = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    named |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import)
              for alias in node.names}
    assert named == {'__future__', 'collections.abc', 'typing', 'numpy', 'numpy.typing',
                     'redundant_planner.core.errors',
                     'redundant_planner.core.safety.position_command'}


def test_the_arm_waits_for_its_first_measurement_and_listens_for_a_second():
    loop = Loop()
    assert loop.ticks(3.0, measured=False) == Decision('waiting for joint_states')
    loop.tick()
    begin = loop.now
    while loop.tick().hold:
        assert loop.decision.hold == 'listening whether another node commands this arm'
        assert not loop.decision.is_fault and loop.supervisor.listening
        assert loop.supervisor.first_motion_within(loop.now, PERIOD) == (
            loop.now + PERIOD >= begin + LISTENING)
    assert loop.now - begin == pytest.approx(LISTENING, abs=1.1 * PERIOD)
    assert loop.decision == Decision() and not loop.supervisor.listening


@given(st.lists(st.floats(0.0, 2.0 * LISTENING), max_size=10))
def test_the_arm_never_moves_within_a_second_of_another_nodes_command(pauses):
    loop = Loop()
    loop.tick()
    heard = -np.inf
    for pause in pauses:
        end = loop.now + pause
        while loop.now < end:
            moved = not loop.tick().hold
            assert not moved or loop.now >= heard + LISTENING - 1e-9
            if moved:
                return
        heard = loop.now
        loop.supervisor.heard_a_command(heard)


def test_an_arm_that_another_node_moves_is_left_alone():
    loop = Loop()
    for _ in range(1000):
        loop.posture = loop.posture + 0.1 * MOVED_BY_OTHERS
        assert loop.tick().hold
    assert loop.ticks(1.1 * LISTENING).hold == ''


def test_its_own_command_is_not_another_nodes(loop):
    loop.supervisor.heard_a_command(loop.now)
    assert not loop.tick().hold


@given(st.floats(0.0, 0.9 * LONGEST_GAP))
def test_old_measurements_stop_the_arm_and_fresh_ones_let_it_go_on(age):
    loop = Loop()
    assume(abs(age - TIMEOUT) > 1e-6)
    loop.ticks(1.1 * LISTENING)
    decision = loop.supervisor.decide(loop.now + age, False, TIMEOUT)
    if age < TIMEOUT:
        assert decision == Decision()
    else:
        assert decision.hold.startswith('no usable joint_states for') and decision.is_fault
        assert decision.warning == 'no usable joint_states for 0.1 s: stopped'
        loop.now += age
        assert not loop.tick().hold


@given(st.floats(-3.0, 3.0), st.integers(0, 1))
def test_the_motion_starts_again_from_rest_after_a_jump(jump, joint):
    loop = Loop()
    loop.ticks(1.1 * LISTENING)
    loop.posture = HOME + jump * np.eye(2)[joint]
    travel = TOLERANCE + PERIOD * FASTEST[joint]
    assume(abs(abs(jump) - travel) > 1e-6)
    jumped = abs(jump) > travel
    first = loop.tick()
    assert ('jumped' in first.hold) == jumped == first.is_fault
    loop.at_rest = False  # braking takes its time
    assert ('jumped' in loop.tick().hold) == jumped
    loop.at_rest = True
    assert loop.tick() == Decision()


@pytest.mark.parametrize('gap', [-100.0, -0.01, 1.01 * LONGEST_GAP, 1e6])
def test_after_a_jump_of_the_clock_the_motion_starts_again_from_rest(loop, gap):
    decision = loop.tick(gap)
    assert decision.time_jumped and decision.is_fault
    assert f'the clock jumped by {gap:.3f} s' in decision.hold
    assert loop.ticks(0.1) == Decision()


def test_a_clock_that_is_set_back_leaves_no_measurement_young_for_ever(loop):
    loop.tick(-100.0, measured=False)
    assert loop.ticks(2.0 * TIMEOUT, measured=False).hold.startswith('no usable joint_states')


def test_a_clock_that_is_set_back_while_listening_does_not_make_it_listen_for_ever():
    loop = Loop()
    loop.tick()
    loop.tick(-1000.0)
    assert not loop.ticks(1.1 * LISTENING).hold


def test_a_gap_without_measurements_is_a_gap_all_the_same(loop):
    assert loop.tick(2.0 * LONGEST_GAP, measured=False).hold.startswith('no usable joint_states')
    loop.at_rest = False
    assert 'the clock jumped' in loop.tick().hold


def test_a_second_publisher_of_commands_stops_the_arm(loop):
    loop.supervisor.found_publishers(['/planner'], ['/joystick'])
    assert loop.tick() == Decision()
    loop.supervisor.found_publishers(['/other', '/planner'], ['/joystick'])
    reason = 'joint_command has 2 publishers: /other, /planner'
    assert loop.tick() == Decision(
        reason, is_fault=True, warning=f'{reason}; stopped until only one is left')
    loop.supervisor.found_publishers(['/planner'], [])
    assert loop.tick() == Decision()


def test_a_second_sender_of_twists_is_ignored_with_the_first(loop):
    loop.supervisor.found_publishers(['/planner'], ['/joystick', '/spacemouse'])
    decision = loop.tick()
    assert not decision.hold and decision.warning == decision.ignore_command == (
        'cmd_vel has 2 publishers, which are not mixed: /joystick, /spacemouse; stop all but one, '
        'or use twist_mux')


def test_a_pause_is_a_wish_and_no_fault(loop):
    assert loop.supervisor.pause(True).startswith('paused: ')
    assert loop.supervisor.pause(True) == PAUSED_ALREADY
    assert loop.ticks(1.0) == Decision('paused')
    loop.posture = HOME + 1.0  # others move the arm meanwhile
    loop.ticks(1.0)
    assert loop.supervisor.pause(False) == 'resumed from where the arm is'
    assert loop.tick() == Decision()


def test_a_pause_that_ends_before_a_tick_comes_counts_all_the_same(loop):
    loop.ticks(1.0)
    loop.supervisor.pause(True)
    loop.supervisor.pause(False)
    assert loop.tick() == Decision('paused')
    assert loop.tick() == Decision()


def test_a_reset_brings_the_arm_to_rest_once(loop):
    assert loop.supervisor.reset().startswith('reset')
    assert loop.tick().hold.startswith('reset') and not loop.supervisor.recovery_due(True)
    assert loop.tick() == Decision()


def test_a_failure_holds_the_arm_until_a_reset_at_rest(loop):
    told = loop.supervisor
    told.fail('fault in the tick')
    assert loop.ticks(5.0) == Decision('fault in the tick', is_fault=True)
    assert not told.recovery_due(True)
    told.reset()
    assert not told.recovery_due(False)
    assert told.recovery_due(True) and not told.recovery_due(True)
    told.recovered()
    assert loop.tick() == Decision()


@given(st.lists(st.sampled_from(
    ['tick', 'silence', 'jump', 'gap', 'pause', 'resume', 'second', 'one', 'fail', 'reset',
     'heard']), max_size=60))
def test_in_any_sequence_of_events_the_arm_moves_only_if_nothing_forbids_it(events):
    loop, paused, second, failed = Loop(), False, False, False
    told = loop.supervisor
    loop.ticks(1.1 * LISTENING)
    for event in events:
        jumped = event in ('jump', 'gap') and not loop.at_rest
        if event == 'pause' or event == 'resume':
            paused = event == 'pause'
            told.pause(paused)
        elif event == 'second' or event == 'one':
            second = event == 'second'
            told.found_publishers(['/planner', '/other'] if second else ['/planner'], [])
        elif event == 'fail':
            failed = True
            told.fail('fault')
        elif event == 'reset':
            told.reset()
        elif event == 'heard':
            told.heard_a_command(loop.now)
        elif event == 'jump':
            loop.posture = loop.posture + 1.0
        if told.recovery_due(loop.at_rest):
            told.recovered()
            failed = False
        if event == 'silence':
            loop.ticks(2.0 * TIMEOUT, measured=False)
        moves = not loop.tick(2.0 * LONGEST_GAP if event == 'gap' else PERIOD,
                              measured=event != 'silence').hold
        forbidden = paused or second or failed or jumped or event == 'silence'
        assert not (moves and forbidden), event
        assert moves or forbidden or event in ('reset', 'jump', 'gap'), event


def test_each_joint_has_an_age_of_its_own_and_the_oldest_counts():
    supervisor, now = Supervisor(FASTEST, TOLERANCE, ('rail', 'arm')), START
    rail, arm = np.array([0]), np.array([1])

    def wait(seconds, *parts):
        nonlocal now
        for _ in range(round(seconds / PERIOD)):
            now += PERIOD
            for part in parts:
                supervisor.measured(HOME, now, part)
            decision = supervisor.decide(now, True, TIMEOUT)
        return decision

    for _ in range(100):
        now += PERIOD
        supervisor.measured(np.array([np.nan, HOME[1]]), now, arm)
        decision = supervisor.decide(now, True, TIMEOUT)
    assert decision.hold == "waiting for joint_states of 'rail': missing for 0.4 s"
    assert not decision.warning  # the other publisher may be about to start
    assert supervisor.posture is None and supervisor.measurement_ages(now).max() == np.inf
    for _ in range(200):
        now += PERIOD
        supervisor.measured(np.array([np.nan, HOME[1]]), now, arm)
        decision = supervisor.decide(now, True, TIMEOUT)
    assert decision.warning == "waiting for joint_states of 'rail': missing for 1.2 s"
    assert wait(2.0 * LISTENING, rail, arm) == Decision()
    decision = wait(0.5 * TIMEOUT, arm)
    assert decision == Decision()
    assert supervisor.measurement_ages(now).max() == pytest.approx(0.5 * TIMEOUT, abs=PERIOD)
    decision = wait(TIMEOUT, arm)
    assert decision.is_fault
    assert decision.hold.startswith("no usable joint_states of 'rail' for 0.1")
    assert decision.warning == "no usable joint_states of 'rail' for 0.1 s: stopped"
    assert wait(2.0 * TIMEOUT).hold.startswith('no usable joint_states for 0.')
    assert wait(PERIOD, rail, arm) == Decision()


def test_joint_states_of_others_alone_are_named_while_the_arm_waits():
    supervisor = Supervisor(FASTEST, TOLERANCE, ('rail', 'arm'))
    supervisor.heard_others(['left_rail', 'left_arm'])
    assert supervisor.decide(START, True, TIMEOUT).hold == (
        "waiting for joint_states of 'rail', 'arm'; those that come are of 'left_rail', "
        "'left_arm'")


def test_a_part_that_comes_seldom_has_not_jumped():
    """In the time since its own last measurement it may move as far as it can."""
    supervisor, now = Supervisor(FASTEST, TOLERANCE, ('slow', 'fast')), START
    posture = HOME.copy()
    while now < START + 2.0 * LISTENING:
        now += PERIOD
        supervisor.measured(posture, now)
        supervisor.decide(now, False, 1.0)
    for tick in range(1, 400):
        now += PERIOD
        posture = posture + [0.0, 0.99 * PERIOD * FASTEST[1]]
        if tick % 100 == 0:  # 0.4 s of full speed, well above the tolerance
            posture[0] += 0.99 * 100 * PERIOD * FASTEST[0]
            supervisor.measured(posture, now, np.array([0]))
        supervisor.measured(posture, now, np.array([1]))
        assert supervisor.decide(now, False, 1.0) == Decision()
    posture = posture + [0.6, 0.0]
    supervisor.measured(posture, now, np.array([0]))
    assert 'jumped' in supervisor.decide(now, False, 1.0).hold


@pytest.mark.parametrize('quiet, tries', [(0.0, False), (0.25, False), (0.31, True)])
def test_an_arm_that_did_not_follow_tries_again_after_a_pause_of_the_stick_alone(quiet, tries):
    """A stick that drops out for a moment is held still."""
    held = Supervisor(FASTEST, TOLERANCE)
    held.heard_a_wish(True, START, False)
    held.does_not_follow('the arm does not follow')
    held.heard_a_wish(True, START + 1.0, True)
    assert not held.tries
    if quiet:
        held.heard_a_wish(False, START + 2.0, True)
    held.heard_a_wish(True, START + 2.0 + quiet, True)
    assert held.tries == tries

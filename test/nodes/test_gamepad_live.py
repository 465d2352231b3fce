"""A gamepad with its file drives a live arm as docs/devices.md says."""

from __future__ import annotations

from bench import ARM, ARM_VALUES, FILE
from device_hands import FORWARD, FULL, LEFT, OnGamepad, panda_with, TURN, UP
from device_nodes import GONE, LET_GO
from live_helpers import LIVE, station
import numpy as np
import pytest

from redundant_planner.io.devices import device_file

pytestmark = LIVE


@pytest.fixture(scope='module')
def station_hand():
    with panda_with('gamepad', OnGamepad) as hand:
        yield hand


@pytest.fixture
def gamepad(station_hand):
    """A test that is tried again finds the device plugged in, wherever it failed."""
    station_hand.plug_in()
    return station_hand


@pytest.mark.parametrize(('sticks', 'twist'), [
    ({'left_y': -FULL}, 0.1 * FORWARD), ({'left_y': FULL}, -0.1 * FORWARD),
    ({'left_x': -FULL}, 0.1 * LEFT), ({'left_x': FULL}, -0.1 * LEFT),
    ({'right_y': -FULL}, 0.1 * UP), ({'right_y': FULL}, -0.1 * UP),
    ({'right_x': -FULL}, 0.4 * TURN), ({'right_x': FULL}, -0.4 * TURN),
    ({'left_y': -FULL, 'right_y': FULL}, 0.1 * (FORWARD - UP))])
def test_the_sticks_move_the_tip_only_with_the_button(gamepad, sticks, twist):
    """SDL counts up and left as negative: pushing a stick forward is -FULL."""
    gamepad.hold(**sticks)
    assert gamepad.still_for(60)
    gamepad.hold('left_shoulder', **sticks)
    gamepad.moves_with(twist)
    gamepad.hold(**sticks)
    gamepad.rests_within(LET_GO['gamepad'])


def test_a_stick_halfway_is_half_as_fast_and_a_little_is_nothing(gamepad):
    dead = 0.1
    gamepad.hold('left_shoulder', left_y=-0.9 * dead * FULL)
    assert gamepad.still_for(60)
    gamepad.hold('left_shoulder', left_y=-(dead + 0.5 * (1.0 - dead)) * FULL)
    gamepad.moves_with(0.05 * FORWARD)
    gamepad.hold('left_shoulder', left_y=(dead + 0.5 * (1.0 - dead)) * FULL)
    gamepad.moves_with(-0.05 * FORWARD)
    gamepad.hold()
    gamepad.rests_within(LET_GO['gamepad'])


def test_the_right_shoulder_is_fast_and_back_to_slow_without_a_stop(gamepad):
    gamepad.hold('right_shoulder', left_x=-FULL)
    gamepad.moves_with(0.25 * LEFT)
    gamepad.hold('right_shoulder', left_x=FULL)
    gamepad.moves_with(-0.25 * LEFT)
    gamepad.ros.commands.clear()
    gamepad.hold('left_shoulder', left_x=FULL)
    gamepad.moves_with(-0.1 * LEFT)
    assert all(np.any(m.velocity) for m in gamepad.ros.commands)
    gamepad.hold('right_shoulder', right_x=-FULL)
    gamepad.moves_with(1.0 * TURN)
    gamepad.hold()
    gamepad.rests_within(LET_GO['gamepad'])


def test_the_arm_of_the_launch_file_stops_as_fast():
    """The paper's arm brakes at 2 m/s² only, and is started without a word about the arm."""
    with station() as (ros, processes):
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        processes.start('planner_node', [*FILE, device_file('gamepad')])
        ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start')
        hand = OnGamepad(ros)
        hand.robot = ARM
        hand.hold('right_shoulder', left_x=FULL)
        hand.moves_with(-0.25 * LEFT[:3])
        hand.hold(left_x=FULL)
        hand.rests_within(LET_GO['gamepad'])
        hand.hold('right_shoulder', left_x=-FULL)
        hand.moves_with(0.25 * LEFT[:3])
        hand.unplug()
        hand.rests_within(GONE['gamepad'])


def test_a_gamepad_that_is_gone_stops_the_arm(gamepad):
    gamepad.hold('left_shoulder', left_y=FULL)
    gamepad.moves_with(-0.1 * FORWARD)
    gamepad.unplug()
    gamepad.rests_within(GONE['gamepad'])
    gamepad.plug_in()
    gamepad.hold()


def test_buttons_of_the_gamepad_pause_go_on_and_reset(gamepad):
    stick = {'left_y': -FULL}
    gamepad.hold('left_shoulder', **stick)
    gamepad.moves_with(0.1 * FORWARD)
    gamepad.hold('left_shoulder', 'back', **stick)
    gamepad.answered('paused')
    gamepad.goes_silent()
    gamepad.hold('left_shoulder', 'start', left_y=FULL)
    gamepad.answered('resumed')
    gamepad.moves_with(-0.1 * FORWARD)
    gamepad.ros.commands.clear()
    gamepad.hold('left_shoulder', 'y', left_y=FULL)
    gamepad.answered('reset')
    gamepad.until(lambda: any(not np.any(m.velocity) for m in gamepad.ros.commands),
                  'rest after the reset')
    gamepad.moves_with(-0.1 * FORWARD)
    assert not gamepad.answers, 'a button that stays down calls once'
    gamepad.hold()
    gamepad.rests_within(LET_GO['gamepad'])

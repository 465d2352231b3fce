"""A keyboard with its file drives a live arm as docs/devices.md says."""

from __future__ import annotations

from device_hands import FORWARD, LEFT, OnKeyboard, panda_with, TURN, UP
from device_nodes import GONE, LET_GO, STOP_KEY
from live_helpers import LIVE
import numpy as np
import pytest

pytestmark = LIVE


@pytest.fixture(scope='module')
def station_hand():
    with panda_with('keyboard', OnKeyboard) as hand:
        yield hand


@pytest.fixture
def keyboard(station_hand):
    """A test that is tried again finds the device plugged in, wherever it failed."""
    station_hand.plug_in()
    return station_hand


@pytest.mark.parametrize(('key', 'twist'), [
    ('i', 0.1 * FORWARD), (',', -0.1 * FORWARD), ('J', 0.1 * LEFT), ('L', -0.1 * LEFT),
    ('t', 0.1 * UP), ('b', -0.1 * UP), ('j', 0.4 * TURN), ('l', -0.4 * TURN)])
def test_a_key_moves_the_tip_and_k_stops_it_at_once(keyboard, key, twist):
    keyboard.hold(key)
    keyboard.moves_with(twist)
    keyboard.press('k')
    keyboard.rests_within(STOP_KEY)


def test_a_held_key_moves_without_a_stop_until_it_is_let_go(keyboard):
    """The keyboard's own pause before it repeats a key is bridged."""
    keyboard.hold('i')
    keyboard.moves_with(0.1 * FORWARD)
    keyboard.ros.commands.clear()
    keyboard.until(lambda: len(keyboard.ros.commands) > 200, 'commands')
    assert all(np.any(m.velocity) for m in keyboard.ros.commands)
    keyboard.let_go()
    keyboard.rests_within(LET_GO['keyboard'])
    keyboard.hold(',')
    keyboard.moves_with(-0.1 * FORWARD)
    keyboard.unplug()
    keyboard.rests_within(GONE['keyboard'])
    keyboard.plug_in()
    keyboard.let_go()


def test_q_is_faster_and_any_other_key_stops(keyboard):
    for _ in range(5):
        keyboard.press('q')
    keyboard.hold(',')
    keyboard.moves_with(-0.1 * 1.1 ** 5 * FORWARD)
    keyboard.press(' ')
    keyboard.rests_within(STOP_KEY)
    for _ in range(5):
        keyboard.press('z')

"""A 3-D mouse with its file drives a live arm as docs/devices.md says."""

from __future__ import annotations

import time

from device_hands import FORWARD, LEFT, OnPuck, panda_with, PITCH, ROLL, TURN, UP
from device_nodes import GONE, LET_GO
from live_helpers import LIVE
import numpy as np
import pytest

pytestmark = LIVE


@pytest.fixture(scope='module')
def station_hand():
    with panda_with('spacemouse', OnPuck) as hand:
        yield hand


@pytest.fixture
def puck(station_hand):
    """A test that is tried again finds the device plugged in, wherever it failed."""
    station_hand.plug_in()
    return station_hand


# The puck's counts: right, up, forward, and about these axes.
@pytest.mark.parametrize(('counts', 'twist'), [
    ((-350, 0, 0, 0, 0, 0), 0.15 * LEFT), ((0, 350, 0, 0, 0, 0), 0.15 * UP),
    ((0, 0, 0, 0, 0, 350), 0.6 * ROLL), ((0, 0, 175, 0, 0, 0), 0.075 * FORWARD),
    *(pytest.param(counts, twist, marks=pytest.mark.long) for counts, twist in (
        ((0, 0, 350, 0, 0, 0), 0.15 * FORWARD), ((0, 0, -350, 0, 0, 0), -0.15 * FORWARD),
        ((350, 0, 0, 0, 0, 0), -0.15 * LEFT), ((0, -350, 0, 0, 0, 0), -0.15 * UP),
        ((0, 0, 0, 0, 350, 0), 0.6 * TURN), ((0, 0, 0, 0, -350, 0), -0.6 * TURN),
        ((0, 0, 0, -350, 0, 0), 0.6 * PITCH), ((0, 0, 0, 0, 0, -350), -0.6 * ROLL),
        ((0, 0, 0, 350, 0, 0), -0.6 * PITCH)))])
def test_the_puck_moves_the_tip_and_springs_back(puck, counts, twist):
    puck.hold(*counts)
    puck.moves_with(twist)
    puck.let_go()
    puck.rests_within(LET_GO['spacemouse'])


@pytest.mark.parametrize('way', ['held still', 'unplugged'])
def test_a_puck_that_falls_silent_stops_the_arm(puck, way):
    """Its node says the last twist again and again, unless it is told to say zero."""
    puck.hold(0, 0, -350 if way == 'held still' else 350, 0, 0, 0)
    puck.moves_with(np.sign(puck.counts[2]) * 0.15 * FORWARD)
    if way == 'unplugged':
        puck.unplug()
    else:
        puck.is_steady, puck.let_go_at = True, time.time()
    puck.rests_within(GONE['spacemouse'])
    assert puck.still_for(60)
    puck.plug_in()
    puck.let_go()


def test_buttons_of_the_puck_pause_and_go_on_afresh(puck):
    forward = (0, 0, 175, 0, 0, 0)
    puck.hold(*forward)
    puck.moves_with(0.075 * FORWARD)
    puck.hold(*forward, buttons=(1, 0))
    puck.answered('paused')
    puck.goes_silent()
    puck.hold(0, 0, -175, 0, 0, 0, buttons=(0, 1))
    puck.until(lambda: len(puck.answers) == 2, 'two answers')
    assert sorted(answer.split()[0] for answer in puck.answers) == ['reset:', 'resumed']
    puck.moves_with(-0.075 * FORWARD)
    puck.let_go()
    puck.rests_within(LET_GO['spacemouse'])

"""When several tips may hold one object, and what the operator moves then."""

from __future__ import annotations

from conftest import HANDS, make_panda, make_two_handed
import numpy as np
import pytest

from redundant_planner.core.planner import Planner
from redundant_planner.core.target.start_posture import start_posture
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.tip_commands import TipCommands
from redundant_planner.nodes.tip_coupling import TipCoupling

BODY = make_two_handed()
READY, REST = start_posture(BODY), np.zeros(BODY.n)


def command_input():
    return CommandInput({}, 'base', lambda: 0.0, lambda: 0.0, lambda sentence: None)


@pytest.fixture
def coupling():
    commands = TipCommands({tip: command_input() for tip in HANDS}, command_input(),
                           command_input(), lambda sentence: None)
    return TipCoupling(BODY, commands)


def test_one_tip_holds_nothing_together():
    panda = make_panda()
    found, why = TipCoupling(panda, command_input()).ask(True, np.zeros(7), np.zeros(7))
    assert not found and 'has one tip' in why


def test_only_a_standing_arm_couples_and_lets_go(coupling):
    for wanted in (True, False):
        for joint in np.eye(BODY.n):
            for velocity in (0.1, -0.1):
                assert not coupling.ask(wanted, REST + velocity * joint, READY)[0]
    assert not coupling.ask(True, REST, None)[0] and not coupling.wanted
    assert coupling.ask(True, REST, READY)[0] and coupling.wanted


def test_what_is_moved_is_each_tip_or_the_object_between_them(coupling):
    planner, tips = Planner(BODY), BODY.kinematics(READY).tips
    coupling.apply(planner, READY)
    assert planner.coupling is None and coupling.no_twist.shape == (2, 6)
    assert coupling.places(planner, tips) is tips
    assert coupling.object_pose(planner, READY) is None
    coupling.ask(True, REST, READY)
    # Wanted, and due with the next tick: a target is meant for the object already.
    before = coupling.places(planner, tips).first
    coupling.apply(planner, READY)
    assert planner.coupling is not None and coupling.no_twist.shape == (6,)
    for held in (before, coupling.places(planner, tips).first,
                 coupling.object_pose(planner, READY)):
        np.testing.assert_allclose(held.position, tips.position.mean(axis=0), atol=1e-12)
    coupling.ask(False, REST, READY)
    coupling.apply(planner, READY)
    assert planner.coupling is None

"""How far commanded positions go ahead of the arm, and what happens if it does not follow."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.step_result import Nearest
from redundant_planner.nodes.arm_watch import ArmWatch
from redundant_planner.nodes.commanded_positions import CommandedPositions
from redundant_planner.nodes.supervisor import Supervisor

PERIOD, LEAD = 0.01, 0.02
FASTEST = np.array([1.0, 1.0])
LIMITS = Limits(np.array([[3.0, 3.0], [-3.0, -3.0]]), FASTEST, np.array([5.0, 5.0]), 0.0)
HOME, ONWARD, SLOWLY = np.array([0.5, -0.5]), np.array([0.5, 0.0]), np.array([0.05, 0.0])


class Arm:
    """One that stands still, and is told to move; nobody hears it."""

    def __init__(self):
        self.supervisor = Supervisor(FASTEST, 0.1, ('a', 'b'))
        self.watch = ArmWatch(self.supervisor, ('a', 'b'), PERIOD, lambda: 'nobody listens')
        self.positions = CommandedPositions(LIMITS, PERIOD, self.watch)
        self.now = 0.0
        # Whose links move by 1 m for each radian, and which is planned to stay.
        self.planner = SimpleNamespace(
            posture_ahead=HOME, robot=SimpleNamespace(lever_arm_bounds=np.ones((1, 2))))
        self.measure()
        self.watch.begin(HOME, 0.0, 0.0)
        self.positions.start(HOME, LEAD)

    def measure(self, there=HOME):
        self.now += PERIOD
        self.supervisor.measured(there, self.now)

    def farthest(self, nearest=None, planner=True):
        """How far from home it is told to be after a second of slow motion."""
        for _ in range(100):
            found = self.positions.next(
                SLOWLY, LEAD, self.planner if planner else None, nearest)
        return float(np.abs(found - HOME).max())


@pytest.fixture
def arm():
    return Arm()


def test_without_a_planned_posture_the_velocities_count(arm):
    assert arm.farthest(planner=False) == pytest.approx(0.05, abs=1e-3)


def test_positions_stay_within_the_lead(arm):
    assert arm.farthest() == pytest.approx(LEAD, abs=2e-3)


@pytest.mark.parametrize(('distance', 'share'), [(0.02, 0.5), (1.0, 1.0), (-0.01, 0.0)])
def test_no_lead_takes_a_link_nearer_to_an_obstacle(arm, distance, share):
    """Both joints ahead by the lead take the link 2 · LEAD further."""
    found = arm.farthest(Nearest('link', 'ball', 0.0, distance))
    assert found == pytest.approx(share * LEAD, abs=2e-3)


def test_an_arm_that_stands_is_told_to_be_where_it_stands(arm):
    for _ in range(300):
        arm.measure()
        arm.watch.look(arm.now, ONWARD, wishes=True, tolerance=LEAD)
        if arm.watch.is_astray:
            break
        arm.positions.next(ONWARD, LEAD, arm.planner, None)
    assert 'does not follow' in arm.supervisor.astray
    assert arm.supervisor.astray.endswith('nobody listens')
    np.testing.assert_array_equal(arm.watch.anchor, HOME)
    assert not arm.positions.are_back
    for _ in range(300):
        found = arm.positions.next(np.zeros(2), LEAD, arm.planner, None)
    np.testing.assert_array_equal(found, HOME)
    assert arm.positions.are_back


def test_an_arm_that_stands_beyond_its_range_comes_to_rest(arm):
    """As one that a load has pressed there: no position leads to where it is."""
    beyond = np.array([0.5, -3.01])
    arm.watch.begin(beyond, 0.0, 0.0)
    for _ in range(300):
        arm.measure(beyond)
        arm.watch.look(arm.now, ONWARD, wishes=True, tolerance=LEAD)
        if arm.watch.is_astray:
            break
        arm.positions.next(ONWARD, LEAD, arm.planner, None)
    np.testing.assert_array_equal(arm.watch.anchor, beyond)
    assert not arm.positions.are_back
    for _ in range(600):
        found = arm.positions.next(np.zeros(2), LEAD, arm.planner, None)
    assert found[1] == pytest.approx(-3.0) and arm.positions.are_back

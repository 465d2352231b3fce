"""An arm that stands: what is a load, a correction or noise, and what is somebody else."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.nodes.standing_arm import StandingArm

T, STILL = 0.004, np.zeros(2)
HOME = np.array([0.3, -0.4])


class Arm:
    """One that has just been told to stay."""

    def __init__(self, lag=0.0):
        self.standing, self.now, self.q = StandingArm(T), 0.0, HOME.copy()
        self.standing.begin(lag, 0.0)

    def rest(self, seconds, speed=(0.0, 0.0), told=STILL, noise=0.0):
        """Let time pass while both joints move at a speed; return whether others do that."""
        random = np.random.default_rng(0)
        for _ in range(round(seconds / T)):
            self.now += T
            self.q = self.q + np.array(speed) * T
            measured = self.q + noise * random.normal(size=2)
            if self.standing.is_moved(self.now, np.asarray(told), measured):
                return True
        return False


@pytest.fixture
def arm():
    return Arm()


def test_a_load_makes_it_sag_as_a_motion_ends(arm):
    """By 15 mrad, by and by: it is held where it was commanded to, and creeps nowhere."""
    for _ in range(1000):
        arm.now += T
        sag = 0.015 * (1.0 - np.exp(-arm.now / 0.2))
        assert not arm.standing.is_moved(arm.now, STILL, HOME - [0.0, sag])


@pytest.mark.parametrize('speed', [0.3, 0.02, 0.001, 0.0006])
def test_somebody_else_moves_it_later(arm, speed):
    assert not arm.rest(2.0)
    begin = arm.q[1]
    assert arm.rest(20.0, speed=(0.0, speed))
    # Fast motion is seen late, and at once where it is far.
    assert arm.q[1] - begin < 5e-3 + 2.0 * T * speed


def test_it_does_what_it_is_told(arm):
    assert not arm.rest(2.0)
    assert not arm.rest(10.0, speed=(0.005, -0.005), told=(0.0052, -0.0048))
    assert arm.rest(10.0, told=(0.0, 0.0), speed=(0.005, 0.0))


def test_corrections_that_its_play_swallows_are_nobody_else(arm):
    assert not arm.rest(2.0)
    assert not arm.rest(2.0, told=(0.002, 0.0))
    assert not arm.rest(2.0, told=(0.002, 0.0), speed=(0.002, 0.0))


def test_corrections_that_nobody_hears_tell_of_somebody_else(arm):
    """Moved by a little: the corrections that follow are not carried out."""
    assert not arm.rest(2.0)
    assert not arm.rest(0.1, speed=(0.008, 0.0))
    assert arm.rest(2.0, told=(-0.001, 0.0))


def test_noise_moves_nothing(arm):
    assert not arm.rest(60.0, noise=5e-4)


def test_a_slow_drive_comes_to_rest_later():
    arm = Arm(lag=0.2)
    for _ in range(1000):
        arm.now += T
        coasts = 0.1 * np.exp(-arm.now / 0.25)
        assert not arm.standing.is_moved(arm.now, STILL, HOME - [0.0, coasts])


def test_a_command_begins_anew(arm):
    assert not arm.rest(2.0)
    assert not arm.rest(2.0, told=(0.1, 0.0), speed=(0.1, 0.0))
    arm.q = arm.q + 0.003
    assert not arm.rest(0.5)
    arm.standing.leave()
    assert not arm.rest(5.0)

"""What is held becomes a twist, and nothing that is let go of keeps the arm moving."""

from __future__ import annotations

import math

from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.playground.drive import (
    DeadMan,
    FADING,
    FASTEST_ANGULAR,
    FASTEST_LINEAR,
    Held,
    KEYS,
    SILENCE,
    SLIDERS_KEY,
    SLOW_KEY,
    SLOWER,
    Speeds,
    twist_of,
    twist_of_gamepad,
    twist_of_keys,
)

SPEEDS = Speeds(0.2, 0.6)
ANY = st.floats(allow_nan=True, allow_infinity=True)


def test_each_axis_has_two_keys_and_they_cancel():
    for axis in range(6):
        keys = [key for key, (a, _) in KEYS.items() if a == axis]
        ends = [twist_of_keys({key}, SPEEDS) for key in keys]
        assert sorted(end[axis] for end in ends) == pytest.approx(
            [-SPEEDS.twist[axis], SPEEDS.twist[axis]])
        assert not twist_of_keys(set(keys), SPEEDS).any()
        assert all(np.count_nonzero(end) == 1 for end in ends)
    slow = twist_of_keys({'KeyW', SLOW_KEY}, SPEEDS)
    np.testing.assert_allclose(slow, SLOWER * twist_of_keys({'KeyW'}, SPEEDS))
    assert not twist_of_keys({'Escape', 'KeyZ'}, SPEEDS).any()


def test_a_gamepad_drives_only_while_a_shoulder_button_is_held():
    sticks = (0.0, -1.0, 0.0, -1.0)  # both forwards, which browsers count negative
    assert not twist_of_gamepad(sticks, [False] * 17, SPEEDS).any()
    held = [i == 5 for i in range(17)]
    np.testing.assert_allclose(
        twist_of_gamepad(sticks, held, SPEEDS), [0.2, 0.0, 0.2, 0.0, 0.0, 0.0])
    turning = [i in (0, 5) for i in range(17)]
    assert not twist_of_gamepad((0.0, -1.0, 0.0, 0.0), turning, SPEEDS)[:3].any()
    # A stick that does not quite come back to its middle moves nothing.
    assert not twist_of_gamepad((0.1, -0.1, 0.1, 0.1), held, SPEEDS).any()


@given(st.lists(ANY, max_size=12), st.lists(st.booleans(), max_size=20))
def test_whatever_a_gamepad_says_the_twist_is_finite_and_slow(axes, buttons):
    twist = twist_of_gamepad(axes, buttons, SPEEDS)
    assert np.isfinite(twist).all() and (np.abs(twist) <= SPEEDS.twist + 1e-12).all()


@given(st.lists(st.tuples(
    st.sampled_from(('hold', 'let_go', 'stop')), st.lists(ANY, min_size=6, max_size=6),
    st.floats(0.0, 1.0), st.floats(0.0, 1.0)), max_size=20))
def test_nothing_drives_longer_than_it_is_held(events):
    dead_man, now, held_at = DeadMan(), 0.0, -math.inf
    for kind, twist, later, age in events:
        now += later
        if kind == 'hold':  # a message that was under way for a while
            held_at = now - age
            dead_man.hold(np.array(twist), held_at)
        elif kind == 'let_go':
            dead_man.let_go(now)
            held_at = -math.inf
        else:
            dead_man.stop(now)
            held_at = -math.inf
        command = dead_man.twist(now)
        if command is not None:
            assert np.isfinite(command).all()
            assert np.abs(command[:3]).max() <= FASTEST_LINEAR
            assert np.abs(command[3:]).max() <= FASTEST_ANGULAR
        if now - held_at > SILENCE:
            assert command is None or not command.any()
    now += SILENCE + 1e-6
    command = dead_man.twist(now)
    assert command is None or not command.any()
    assert dead_man.twist(now + FADING + 1e-6) is None


def test_one_that_falls_silent_has_let_go():
    dead_man = DeadMan()
    assert dead_man.twist(0.0) is None
    dead_man.hold(np.full(6, 0.1), 1.0)
    assert dead_man.twist(1.0 + SILENCE).all()
    assert not dead_man.twist(1.0 + SILENCE + 1e-6).any()
    assert dead_man.twist(1.0 + SILENCE + FADING + 0.01) is None


def test_all_that_is_held_adds_up_and_the_sliders_count_while_their_key_is_held():
    sliders, pad = np.linspace(-0.3, 0.3, 6), ((0.0, -1.0), (False,) * 5 + (True,))
    assert twist_of(Held(), SPEEDS, sliders) is None
    keys = twist_of(Held(0.0, frozenset({'KeyW'})), SPEEDS, sliders)
    np.testing.assert_allclose(keys, twist_of_keys({'KeyW'}, SPEEDS))
    np.testing.assert_allclose(
        twist_of(Held(0.0, frozenset({'KeyW', SLIDERS_KEY}), *pad), SPEEDS, sliders),
        keys + sliders + twist_of_gamepad(*pad, SPEEDS))


@pytest.mark.parametrize('speeds', [Speeds(math.inf, 1e9), Speeds(-1.0, -1.0)])
def test_no_slider_makes_it_faster_than_a_page_may_be(speeds):
    assert (speeds.twist >= 0.0).all()
    assert (speeds.twist <= np.repeat((FASTEST_LINEAR, FASTEST_ANGULAR), 3)).all()

"""drive: keys of a terminal, as twists on a real topic."""

from __future__ import annotations

import io
import os
import pty
import signal
import subprocess
import sys

from geometry_msgs.msg import Twist
from live_helpers import every, LIVE, station
import numpy as np
import pytest

from redundant_planner.tools.drive import Held, main


def test_a_key_holds_until_it_would_have_come_again():
    held = Held(0.1)
    assert not held.twist(0.0).any()
    held.press('w', 0.0)
    np.testing.assert_array_equal(held.twist(0.59), [0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert not held.twist(0.61).any()
    # It repeats: from now on it holds for as long as repetition takes.
    held.press('w', 1.0)
    held.press('w', 1.5)
    assert held.twist(1.64).any() and not held.twist(1.66).any()
    # A repetition that comes late is a new key.
    held.press('w', 2.0)
    assert held.twist(2.55).any()


@pytest.mark.parametrize(('key', 'axis', 'value'), [
    ('w', 0, 0.1), ('s', 0, -0.1), ('a', 1, 0.1), ('d', 1, -0.1), ('r', 2, 0.1), ('f', 2, -0.1),
    ('u', 3, -0.3), ('o', 3, 0.3), ('i', 4, 0.3), ('k', 4, -0.3), ('j', 5, 0.3), ('l', 5, -0.3)])
def test_each_key_moves_along_or_about_one_axis(key, axis, value):
    held = Held(0.1)
    held.press(key, 0.0)
    expected = np.zeros(6)
    expected[axis] = value
    np.testing.assert_allclose(held.twist(0.1), expected)


def test_other_keys_stop_and_the_speed_is_bounded():
    held = Held(0.1)
    held.press('w', 0.0)
    held.press(' ', 0.1)
    assert not held.twist(0.2).any()
    for _ in range(50):
        held.press('+', 0.3)
    held.press('w', 0.4)
    assert held.twist(0.5)[0] == 1.0
    held.press('-', 0.5)
    assert held.twist(0.6)[0] == pytest.approx(1.0 / 1.2)


def test_without_a_terminal_it_says_so(capsys, monkeypatch):
    monkeypatch.setattr('sys.stdin', io.StringIO())
    assert main([]) == 2 and 'standard input is none' in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(['--speed', '3'])
    assert '--speed is 3.0' in capsys.readouterr().err


@pytest.mark.live
@LIVE
@pytest.mark.parametrize('by_signal', [False, True])
def test_a_key_is_a_stream_of_twists_that_ends_with_a_zero(by_signal):
    with station() as (ros, _):
        heard = []
        ros.node.create_subscription(Twist, 'cmd_vel', heard.append, 100)
        ours, theirs = pty.openpty()
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(ros.node.context.get_domain_id())}
        process = subprocess.Popen(
            [sys.executable, '-m', 'redundant_planner.tools.drive', '--speed', '0.2'],
            env=environment, stdin=theirs, stdout=theirs, stderr=theirs)

        def press_until_heard():
            os.write(ours, b'a')

        ros.wait_for(lambda: len(heard) > 5, 'twists', meanwhile=every(0.1, press_until_heard))
        assert all(m.linear.y in (0.0, 0.2) for m in heard) and heard[-1].linear.y == 0.2
        if by_signal:
            process.send_signal(signal.SIGINT)
        else:
            os.write(ours, b'q')
        ros.wait_for(lambda: process.poll() is not None, 'the end of drive')
        ros.wait_for(lambda: heard[-1].linear.y == 0.0, 'the last zero')
        assert process.returncode == 0
        os.close(theirs)
        os.close(ours)

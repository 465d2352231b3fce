"""Letting go stops the arm: the page's own process, real connections, and what cmd_vel says."""

from __future__ import annotations

from contextlib import contextmanager, ExitStack
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time
from urllib.parse import parse_qs, urlsplit
from urllib.request import urlopen

from geometry_msgs.msg import Twist
from live_helpers import LIVE, PATIENCE, station
import msgspec
import pytest
import viser
from websockets.sync.client import connect
import zstandard

from redundant_planner.playground.drive import SILENCE

pytestmark = [pytest.mark.live, LIVE]
# How often a page tells [s], and how many twists the page sends meanwhile at most, with those
# that are under way: 30 each second.
BEAT, UNDER_WAY = 0.06, 5
# The first message of a viser client; it counts as a visitor from then on.
CAMERA = {
    'type': 'ViewerCameraMessage', 'wxyz': (1.0, 0.0, 0.0, 0.0), 'position': (1.0, 1.0, 1.0),
    'fov': 1.0, 'near': 0.01, 'far': 100.0, 'image_height': 600, 'image_width': 800,
    'look_at': (0.0, 0.0, 0.0), 'up_direction': (0.0, 0.0, 1.0)}


class Page:
    """The driver's page, without a browser, and the process that serves it."""

    def __init__(self, ros, process, port, token):
        self._ros, self.process, self.port, self._clock = ros, process, port, 0.0
        self._connection = connect(f'ws://localhost:{port}/held?token={token}',
                                   origin=f'http://localhost:{port}')
        self.moves: list[bool] = []
        ros.node.create_subscription(
            Twist, 'cmd_vel', lambda twist: self.moves.append(twist.linear.x != 0.0), 1000)

    def tell(self, *keys):
        """Tell what is held, with the clock of the last answer, as page.js does."""
        try:
            while True:
                self._clock = float(self._connection.recv(timeout=0))
        except TimeoutError:
            pass
        self._connection.send(json.dumps({'clock': self._clock, 'keys': keys, 'pad': None}))

    def disconnect(self):
        """Lose the connection."""
        self._connection.close()

    def hold(self, seconds):
        """Hold a key for so long, and see the page drive."""
        end, self.moves = time.monotonic() + seconds, []
        while time.monotonic() < end or not any(self.moves[-3:]):
            assert time.monotonic() < end + PATIENCE, 'the page does not drive'
            self.tell('KeyW')
            self._wait(BEAT)

    def _wait(self, seconds):
        end = time.monotonic() + seconds
        self._ros.wait_for(lambda: time.monotonic() > end)

    def moving_until_it_stops(self):
        """Return how many moving twists come from now on until it stops, by ten zeros."""
        self.moves = []
        self._ros.wait_for(lambda: self.moves[-10:] == [False] * 10, 'a stop')
        return sum(self.moves)


@contextmanager
def driven(tmp_path):
    """Yield the page of a driver; there is no arm behind it."""
    log = tmp_path / 'log'
    with station() as (ros, _), ExitStack() as end:
        output = end.enter_context(log.open('w'))
        process = subprocess.Popen(
            [sys.executable, '-m', 'redundant_planner.tools.playground', '--attach', '--drive',
             '--port', '0', '--recordings', str(tmp_path)], stdout=output, stderr=output,
            env=dict(os.environ, ROS_DOMAIN_ID=str(ros.node.context.get_domain_id())))
        end.callback(process.wait)
        end.callback(process.kill)
        ros.wait_for(lambda: 'open http' in log.read_text() or process.poll() is not None, 'it')
        text = log.read_text()
        address = re.search(r'open (http\S+)', text).group(1)
        with urlopen(address) as page:
            of_viser, = parse_qs(urlsplit(page.url).query)['websocket']
        visitor = end.enter_context(connect(
            of_viser, subprotocols=[f'viser-v{viser.__version__}'], max_size=None))
        yield Page(ros, process, urlsplit(address).port, token_of(visitor))
        # It ends while its page is open.
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0, log.read_text()
        assert 'Traceback' not in log.read_text(), log.read_text()


def token_of(visitor):
    """Return the token that viser shows to a driver."""
    visitor.send(msgspec.msgpack.encode(CAMERA))
    while True:
        message = visitor.recv(timeout=PATIENCE)
        shown = zstandard.ZstdDecompressor().decompressobj().decompress(message[16:])
        if found := re.search(rb'playground-token="([^"]+)"', shown):
            return found.group(1).decode()


def memory_of(process):
    """Return what a process has for itself [MB]."""
    status = Path(f'/proc/{process.pid}/status').read_text()
    return int(re.search(r'RssAnon:\s+(\d+)', status).group(1)) / 1024


@pytest.mark.long
def test_a_flood_of_watchers_neither_keeps_the_arm_moving_nor_takes_memory(tmp_path):
    with driven(tmp_path) as page, ExitStack() as flood:
        page.hold(0.5)
        before = memory_of(page.process)
        for _ in range(4):
            flooder = subprocess.Popen(
                [sys.executable, str(Path(__file__).parent / 'flooder.py'), str(page.port)])
            flood.callback(flooder.wait)
            flood.callback(flooder.kill)
        for _ in range(3):
            page.hold(1.5)
            page.tell()
            assert page.moving_until_it_stops() <= UNDER_WAY
        assert memory_of(page.process) < before + 50.0


def test_what_was_held_before_the_process_stood_still_drives_no_more(tmp_path):
    with driven(tmp_path) as page:
        for is_released in (True, False):
            page.hold(0.5)
            os.kill(page.process.pid, signal.SIGSTOP)
            begin = time.monotonic()
            while time.monotonic() < begin + 3 * SILENCE:
                page.tell('KeyW')
                time.sleep(BEAT)
            if is_released:
                page.tell()
            os.kill(page.process.pid, signal.SIGCONT)
            # One twist may have been decided on already.
            assert page.moving_until_it_stops() <= 1
        page.hold(0.5)
        page.disconnect()
        assert page.moving_until_it_stops() <= UNDER_WAY

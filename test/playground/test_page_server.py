"""The page is served to its own visitors alone, and survives what they send."""

from __future__ import annotations

from contextlib import closing, ExitStack
import http.client
import json
import math
import socket
import time

from hypothesis import given, strategies as st
from live_helpers import PATIENCE
import numpy as np
import pytest
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.http11 import Request
from websockets.sync.client import connect

from redundant_planner.core.errors import PlannerError
from redundant_planner.playground import page_server
from redundant_planner.playground.drive import DeadMan, Held, SILENCE
from redundant_planner.playground.page_server import held_of, PageServer

MOST_CONNECTIONS = page_server._MOST_CONNECTIONS
JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
    lambda children: st.lists(children) | st.dictionaries(st.text(), children), max_leaves=20)


@pytest.fixture
def page():
    server = PageServer('127.0.0.1', 0, 8099)
    server.port = int(server.url.rsplit(':', 1)[1].strip('/'))
    yield server
    server.close()


def asked(page, path, host='localhost'):
    connection = http.client.HTTPConnection('127.0.0.1', page.port, timeout=30)
    connection.request('GET', path, headers={'Host': f'{host}:{page.port}'})
    answer = connection.getresponse()
    return answer.status, answer.read().decode(), dict(answer.getheaders())


def test_the_page_is_that_of_viser_with_our_script(page):
    status, _, headers = asked(page, '/')
    assert status == 302
    assert headers['Location'] == '/?websocket=ws%3A%2F%2Flocalhost%3A8099'
    status, text, _ = asked(page, headers['Location'])
    assert status == 200 and '<title>redundant_planner playground</title>' in text
    assert '"ArrowLeft"' in text and '__KEYS__' not in text
    # A page that names another place to connect to is sent back.
    assert asked(page, '/?websocket=ws%3A%2F%2Fevil.example%3A1')[0] == 302


@pytest.mark.parametrize('path', ['/../setup.py', '/report/../../setup.py', '/report/none', '/x'])
def test_no_other_file_is_served(page, path):
    assert asked(page, path)[0] == 404


def test_a_report_is_served_by_its_name(page, tmp_path):
    (tmp_path / 'report.html').write_text('<p>measured</p>')
    page.reports['bag 1'] = tmp_path / 'report.html'
    assert asked(page, '/report/bag%201')[:2] == (200, '<p>measured</p>')


@pytest.mark.parametrize(('path', 'headers'), [
    *((path, {}) for path in ('[', 'http://[', '//[', 'x')),
    *(('/', {'Host': host}) for host in ('', '[', 'http://[', '[::1', 'localhost:x', 'a/b')),
    *(('/held?token=mine', {'Origin': origin}) for origin in ('[', 'http://[', '//]', 'x'))])
def test_a_malformed_request_is_answered_as_such(page, caplog, path, headers):
    page.admit('mine')
    own = f'localhost:{page.port}'
    with closing(http.client.HTTPConnection('127.0.0.1', page.port, timeout=30)) as connection:
        connection.request('GET', path, headers={
            'Host': own, 'Origin': f'http://{own}', **headers})
        assert connection.getresponse().status == 400
    assert not caplog.records


def test_a_header_that_is_given_twice_is_malformed(page, caplog):
    with socket.create_connection(('127.0.0.1', page.port), timeout=30) as connection:
        connection.sendall(b'GET / HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\n\r\n')
        assert connection.recv(100).startswith(b'HTTP/1.1 400')
    assert not caplog.records


def visitor(page, token, origin=None):
    own = f'http://localhost:{page.port}'
    return connect(f'ws://localhost:{page.port}/held?token={token}', origin=origin or own)


def tell(connection, *keys, clock=None, pad=None):
    """Tell what is held, and return the server's clock when it has taken it."""
    now = time.monotonic() if clock is None else clock
    connection.send(json.dumps({'clock': now, 'keys': keys, 'pad': pad}))
    return float(connection.recv(timeout=30))


def wait_for(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_another_site_neither_drives_nor_pretends_to_be_this_one(page):
    page.admit('mine')
    assert asked(page, '/', host='evil.example')[0] == 403
    for origin in ('http://evil.example', f'http://localhost:{page.port + 1}', 'null'):
        with pytest.raises(InvalidStatus, match='403'):
            visitor(page, 'mine', origin)


def test_only_the_driver_is_heard(page):
    for token in ('', 'mine', 'another'):
        with pytest.raises(InvalidStatus, match='403'):
            visitor(page, token)
    page.admit('mine')
    page.take()
    for token in ('', 'another', 'mine&token=another'):
        with pytest.raises(InvalidStatus, match='403'):
            visitor(page, token)
    with visitor(page, 'mine') as before:
        tell(before, 'KeyW')
        page.admit('another')
        # The one before is hung up and has let go.
        with pytest.raises(ConnectionClosed):
            before.recv(timeout=30)
        assert page.take() == Held()
        with visitor(page, 'another') as after:
            tell(after, 'KeyS')
            assert page.take().keys == {'KeyS'}


def test_what_is_held_arrives_and_a_lost_connection_too(page):
    page.admit('mine')
    with visitor(page, 'mine') as driver:
        driver.send('nonsense')
        driver.recv(timeout=30)
        assert page.take() == Held()
        tell(driver, 'KeyW', clock=1.0)
        assert page.take() == Held(1.0, frozenset({'KeyW'}))
        assert page.take() is None
        tell(driver, clock=2.0, pad={'axes': [0.5], 'buttons': [True, 1]})
        assert page.take() == Held(2.0, frozenset(), (0.5,), (True, False))
        # The page comes back before the server knows that its connection is dead.
        tell(driver, 'KeyW')
        with visitor(page, 'mine') as again:
            wait_for(lambda: page.take() == Held())
            tell(again, 'KeyW')
            assert page.take().keys == {'KeyW'}
    wait_for(lambda: page.take() == Held())


def test_of_many_messages_the_newest_is_kept(page):
    page.admit('mine')
    with visitor(page, 'mine') as driver:
        for i in range(200):
            tell(driver, f'Key{i}')
        assert page.take().keys == {'Key199'}
        assert page.take() is None


@given(st.floats(), st.floats(0.0, 1e6))
def test_a_message_is_never_newer_than_the_clock_that_it_carries_and_than_now(clock, now):
    held = held_of(json.dumps({'clock': clock, 'keys': ['KeyW']}), now)
    if held is None:
        assert not math.isfinite(min(clock, now))
    else:
        assert held.at <= now and held.at <= clock


def test_what_lay_in_a_buffer_is_as_old_as_it_is(page):
    # As it is for a server that stood still: the driver's page goes on telling meanwhile, and
    # knows no later clock than that of the last answer.
    page.admit('mine')
    with visitor(page, 'mine') as driver:
        clock = tell(driver, 'KeyW')
        page.take()
        with page._lock:  # nothing is heard as long as it is taken
            for _ in range(20):
                driver.send(json.dumps({'clock': clock, 'keys': ['KeyW'], 'pad': None}))
            time.sleep(1.2 * SILENCE)
        for _ in range(20):
            driver.recv(timeout=30)
        dead_man, held = DeadMan(), page.take()
        assert held.keys == {'KeyW'}
        dead_man.hold(np.full(6, 0.1), held.at)
        assert not dead_man.twist(time.monotonic()).any()
        # The first answer after that is enough to drive again.
        tell(driver, 'KeyW', clock=time.monotonic())
        dead_man.hold(np.full(6, 0.1), page.take().at)
        assert dead_man.twist(time.monotonic()).all()


def test_connections_are_few_and_the_driver_keeps_theirs(page):
    page.admit('mine')
    with visitor(page, 'mine') as driver, ExitStack() as idle:
        connections = [idle.enter_context(closing(socket.create_connection(
            ('127.0.0.1', page.port), timeout=30))) for _ in range(3 * MOST_CONNECTIONS)]
        # The server hangs up on all but the newest.
        for connection in connections[:-MOST_CONNECTIONS]:
            assert connection.recv(1) == b''
        assert len(page._others) <= MOST_CONNECTIONS
        tell(driver, 'KeyW')
        assert page.take().keys == {'KeyW'}
        # And the page can be opened all the same.
        assert asked(page, '/')[0] == 302


def test_no_connection_lives_long_but_the_drivers(page, monkeypatch):
    monkeypatch.setattr(page_server, '_LIFETIME', 0.2)
    page.admit('mine')
    with visitor(page, 'mine') as driver, closing(socket.create_connection(
            ('127.0.0.1', page.port), timeout=30)) as idle:
        assert idle.recv(1) == b''
        tell(driver, 'KeyW')
        assert page.take().keys == {'KeyW'}


PARTS = st.text('[]:/@?#%.ahtp12')


@given(PARTS, PARTS, PARTS)
def test_whatever_is_asked_for_is_malformed_or_has_its_parts(path, host, origin):
    try:
        parts = page_server._parts(Request(path, Headers(Host=host, Origin=origin)))
    except ValueError:
        return
    assert parts[0].netloc == host and parts[0].hostname and parts[2].path.startswith('/')


@given(JSON)
def test_whatever_a_visitor_sends_is_sound_or_nothing(content):
    for message in (json.dumps(content), json.dumps({'clock': content, 'keys': content}),
                    json.dumps({'clock': 0.0, 'keys': [], 'pad': content}),
                    json.dumps({'clock': 0.0, 'keys': [], 'pad': {
                        'axes': content, 'buttons': content}})):
        held = held_of(message, 1.0)
        assert held is None or (len(held.axes) <= 8 and len(held.buttons) <= 20
                                and all(abs(x) < float('inf') for x in held.axes))


def test_a_port_that_is_taken_is_an_error_in_one_line(page):
    with pytest.raises(PlannerError, match='--port takes another'):
        PageServer('127.0.0.1', page.port, 1)

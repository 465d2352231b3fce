"""The page is served to its own visitors alone, and survives what they send."""

from __future__ import annotations

import http.client
import json
from queue import SimpleQueue

from hypothesis import given, strategies as st
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from redundant_planner.core.errors import PlannerError
from redundant_planner.playground.page_server import Held, held_of, PageServer

JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
    lambda children: st.lists(children) | st.dictionaries(st.text(), children), max_leaves=20)


@pytest.fixture
def page():
    heard, gone = SimpleQueue(), SimpleQueue()
    server = PageServer('127.0.0.1', 0, 8099, heard.put, gone.put)
    server.heard, server.gone = heard, gone
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


def test_another_site_neither_drives_nor_pretends_to_be_this_one(page):
    assert asked(page, '/', host='evil.example')[0] == 403
    for origin in ('http://evil.example', f'http://localhost:{page.port + 1}', None):
        with pytest.raises(InvalidStatus, match='403'):
            connect(f'ws://localhost:{page.port}/held', origin=origin)


def test_what_is_held_arrives_and_a_lost_connection_too(page):
    with connect(f'ws://localhost:{page.port}/held',
                 origin=f'http://localhost:{page.port}') as visitor:
        visitor.send('nonsense')
        visitor.send(json.dumps({'token': 'mine', 'keys': ['KeyW'], 'pad': None}))
        assert page.heard.get(timeout=30) == Held('mine', frozenset({'KeyW'}))
        visitor.send(json.dumps({'token': 'mine', 'keys': [], 'pad': {
            'axes': [0.5], 'buttons': [True, 1]}}))
        assert page.heard.get(timeout=30) == Held('mine', frozenset(), (0.5,), (True, False))
    assert page.gone.get(timeout=30) == 'mine'


@given(JSON)
def test_whatever_a_visitor_sends_is_sound_or_nothing(content):
    for message in (json.dumps(content), json.dumps({'token': content, 'keys': content}),
                    json.dumps({'token': 'x', 'keys': [], 'pad': content}),
                    json.dumps({'token': 'x', 'keys': [], 'pad': {
                        'axes': content, 'buttons': content}})):
        held = held_of(message)
        assert held is None or (len(held.axes) <= 8 and len(held.buttons) <= 20
                                and all(abs(x) < float('inf') for x in held.axes))


def test_a_port_that_is_taken_is_an_error_in_one_line(page):
    with pytest.raises(PlannerError, match='--port takes another'):
        PageServer('127.0.0.1', page.port, 1, print, print)

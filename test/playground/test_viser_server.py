"""viser says nothing of its own address, and its port leads to the page."""

from __future__ import annotations

from urllib.request import urlopen

import pytest
from websockets.sync.client import connect

viser = pytest.importorskip('viser')

from redundant_planner.playground.viser_server import lead_to, viser_server  # noqa: E402


def test_its_port_leads_to_the_page_and_it_prints_nothing(tmp_path, capfd):
    kind = viser.infra.WebsockServer
    server = viser_server('localhost', 0, tmp_path)
    try:
        assert viser.infra.WebsockServer is kind
        lead_to(8123, tmp_path)
        with urlopen(f'http://localhost:{server.get_port()}/', timeout=10.0) as answer:
            text = answer.read().decode()
        assert 'location.replace' in text and ':8123/' in text and 'port 8123' in text
        # The page's own connection goes there as before.
        with connect(f'ws://localhost:{server.get_port()}',
                     subprotocols=[f'viser-v{viser.__version__}']) as connection:
            assert connection.recv(timeout=10.0)
    finally:
        server.stop()
    assert capfd.readouterr() == ('', '')

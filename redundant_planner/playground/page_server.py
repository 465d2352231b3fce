"""The page itself: viser's client with a script of ours in it, reports, and what is held."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import html
import http
import json
import math
from pathlib import Path
from threading import Thread
from urllib.parse import parse_qs, quote, unquote, urlsplit

import viser
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import serve, Server, ServerConnection

from redundant_planner.core.errors import PlannerError
from redundant_planner.playground.drive import KEYS, SLIDERS_KEY, SLOW_KEY

_LOOPBACK = ('localhost', '127.0.0.1', '::1')
_TITLE = 'redundant_planner playground'
# What one message of the page may hold.
_LONGEST, _MOST_KEYS, _MOST_AXES, _MOST_BUTTONS = 4000, 20, 8, 20


@dataclass(frozen=True)
class Held:
    """What a visitor holds.

    Attributes:
        token: tells whose it is.
        keys: a browser's names of them.
        axes: of a gamepad, −1 to 1; empty without one.
        buttons: of it, whether each is pressed.
    """

    token: str
    keys: frozenset[str] = frozenset()
    axes: tuple[float, ...] = ()
    buttons: tuple[bool, ...] = ()


def held_of(text: str | bytes) -> Held | None:
    """Return what a message of the page says; None if it makes no sense."""
    try:
        content = json.loads(text)
        pad = content.get('pad') or {}
        found = Held(str(content['token']), frozenset(map(str, content['keys'])),
                     tuple(float(x) for x in pad.get('axes', ())),
                     tuple(x is True for x in pad.get('buttons', ())))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
        return None
    sound = (len(found.keys) <= _MOST_KEYS and len(found.axes) <= _MOST_AXES
             and len(found.buttons) <= _MOST_BUTTONS and all(map(math.isfinite, found.axes)))
    return found if sound else None


class PageServer:
    """Serves the page on a port of its own, and hears from it.

    Attributes:
        url: where to open it.
        reports: name → file of each report that can be opened.
    """

    def __init__(
        self, host: str, port: int, viser_port: int, hear: Callable[[Held], object],
        gone: Callable[[str], object],
    ) -> None:
        """Begin to serve.

        Args:
            host: address to listen on.
            port: to listen on.
            viser_port: where viser's connections go.
            hear: takes what a visitor holds, on a thread per visitor.
            gone: takes the token of one whose connection has ended.

        Raises:
            PlannerError: the port is taken, or the address none of this machine's.
        """
        self.reports: dict[str, Path] = {}
        self._host, self._viser_port = host, viser_port
        self._hear, self._gone = hear, gone
        self._page = _page()
        try:
            self._server: Server = serve(
                self._visitor, host, port, process_request=self._answer, max_size=_LONGEST,
                compression=None)
        except OSError as error:
            raise PlannerError(f'the page cannot be served on {host}:{port}: {error.strerror}; '
                               '--port takes another') from None
        self._port = self._server.socket.getsockname()[1]
        self.url = f'http://{"localhost" if host in _LOOPBACK else host}:{self._port}/'
        Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        """End."""
        self._server.shutdown()

    def _visitor(self, connection: ServerConnection) -> None:
        """Hear one visitor until the connection ends."""
        token = ''
        try:
            for message in connection:
                held = held_of(message)
                if held is not None:
                    token = held.token
                    self._hear(held)
        except ConnectionClosed:
            pass
        finally:
            if token:
                self._gone(token)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request for a page; None lets a visitor's connection through."""
        host = request.headers.get('Host', '')
        name = urlsplit(f'//{host}').hostname or ''
        # A page of another site must not drive the arm, nor pretend to be this one by its name.
        if self._host in _LOOPBACK and name not in _LOOPBACK:
            return _text(http.HTTPStatus.FORBIDDEN, 'open this page as localhost')
        asked = urlsplit(request.path)
        if asked.path == '/held':
            origin = urlsplit(request.headers.get('Origin', '')).netloc
            return None if origin == host else _text(
                http.HTTPStatus.FORBIDDEN, 'this is for the playground page alone')
        if asked.path.startswith('/report/'):
            file = self.reports.get(unquote(asked.path.removeprefix('/report/')))
            if file is None or not file.is_file():
                return _text(http.HTTPStatus.NOT_FOUND, 'there is no such report')
            return _html(file.read_bytes())
        if asked.path != '/':
            return _text(http.HTTPStatus.NOT_FOUND, 'there is nothing here')
        shown = f'[{name}]' if ':' in name else name
        there = f'ws://{shown}:{self._viser_port}'
        if parse_qs(asked.query).get('websocket') != [there]:
            return Response(http.HTTPStatus.FOUND, 'Found', Headers({
                'Location': f'/?websocket={quote(there, safe="")}', 'Content-Length': '0'}))
        return _html(self._page)


def _page() -> bytes:
    """Return viser's client with our title and script."""
    file = Path(viser.__file__).parent / 'client' / 'build' / 'index.html'
    try:
        text = file.read_text(encoding='utf-8')
    except OSError as error:
        raise PlannerError(
            f"viser {viser.__version__} has no '{file}' ({error.strerror}); the page needs viser "
            "1: pip install 'viser>=1.0,<2'") from None
    keys = json.dumps([*KEYS, SLIDERS_KEY, SLOW_KEY])
    script = (Path(__file__).parent / 'page.js').read_text().replace('__KEYS__', keys)
    head, begin, rest = text.partition('<title>Viser</title>')
    if not begin:
        head, begin, rest = text.partition('<head>')
        head += begin
    return (f'{head}<title>{html.escape(_TITLE)}</title>\n<script>{script}</script>{rest}'
            ).encode()


def _html(content: bytes) -> Response:
    return Response(http.HTTPStatus.OK, 'OK', Headers({
        'Content-Type': 'text/html; charset=utf-8', 'Content-Length': str(len(content)),
        'Cache-Control': 'no-store', 'X-Frame-Options': 'DENY'}), content)


def _text(status: http.HTTPStatus, sentence: str) -> Response:
    content = f'{sentence}\n'.encode()
    return Response(status.value, status.phrase, Headers({
        'Content-Type': 'text/plain; charset=utf-8', 'Content-Length': str(len(content))}),
        content)

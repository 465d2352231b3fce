"""The page itself: viser's client with a script of ours in it, reports, and what is held.

Only the driver's page gets a connection to tell what is held: its address carries the token that
viser shows to the driver alone. What is held counts from the moment when the page surely held it.
After each message the server tells the page its clock, and the page's next message gives that
back. So a message that lay in a buffer while this process, the page or the network stood still is
as old as it is.
"""

from __future__ import annotations

from contextlib import suppress
import html
import http
import json
import math
from pathlib import Path
import socket
from threading import Lock, Thread
import time
from urllib.parse import parse_qs, quote, SplitResult, unquote, urlsplit

import viser
from websockets.datastructures import Headers, MultipleValuesError
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import serve, Server, ServerConnection

from redundant_planner.core.errors import PlannerError
from redundant_planner.playground.drive import Held, KEYS, SLIDERS_KEY, SLOW_KEY

_LOOPBACK = ('localhost', '127.0.0.1', '::1')
_TITLE = 'redundant_planner playground'
# What one message of the page may hold.
_LONGEST, _MOST_KEYS, _MOST_AXES, _MOST_BUTTONS = 4000, 20, 8, 20
# Connections at once, besides the driver's: one more, and the server hangs up on the oldest. None
# lives longer than this [s].
_MOST_CONNECTIONS, _LIFETIME = 16, 30.0
# The least time between two messages of the driver, and between two connections [s]. A flood of
# either leaves the loop that drives the arm its time.
_PAUSE = 0.01


def held_of(text: str | bytes, now: float) -> Held | None:
    """Return what a message of the page says that came now; None if it makes no sense.

    A clock that is ahead of ours counts as now.
    """
    try:
        content = json.loads(text)
        pad = content.get('pad') or {}
        found = Held(min(float(content['clock']), now), frozenset(map(str, content['keys'])),
                     tuple(float(x) for x in pad.get('axes', ())),
                     tuple(x is True for x in pad.get('buttons', ())))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
        return None
    sound = (len(found.keys) <= _MOST_KEYS and len(found.axes) <= _MOST_AXES
             and len(found.buttons) <= _MOST_BUTTONS
             and all(map(math.isfinite, (found.at, *found.axes))))
    return found if sound else None


class PageServer:
    """Serves the page on a port of its own, and hears from the driver's.

    Attributes:
        url: where to open it.
        reports: name → file of each report that can be opened.
    """

    def __init__(self, host: str, port: int, viser_port: int) -> None:
        """Begin to serve.

        Args:
            host: address to listen on.
            port: to listen on.
            viser_port: where viser's connections go.

        Raises:
            PlannerError: the port is taken, or the address none of this machine's.
        """
        self.reports: dict[str, Path] = {}
        self._host, self._viser_port = host, viser_port
        self._page = _page()
        # The driver's token and connection, and the newest that is held and was not taken yet.
        self._lock, self._token = Lock(), ''
        self._driver: ServerConnection | None = None
        self._newest: Held | None = None
        # Connections of all others → when they began, the oldest first.
        self._others: dict[socket.socket, float] = {}
        self._closed = False
        try:
            self._server: Server = serve(
                self._hear, host, port, process_request=self._answer, max_size=_LONGEST,
                compression=None, close_timeout=1.0)
        except OSError as error:
            raise PlannerError(f'the page cannot be served on {host}:{port}: {error.strerror}; '
                               '--port takes another') from None
        self._server.socket.settimeout(1.0)
        self._port = self._server.socket.getsockname()[1]
        self.url = f'http://{"localhost" if host in _LOOPBACK else host}:{self._port}/'
        Thread(target=self._let_in, daemon=True).start()

    def close(self) -> None:
        """End, and hang up on all."""
        self._closed = True
        self._server.shutdown()
        self.admit('')
        for other in list(self._others):
            _hang_up(other)

    def admit(self, token: str) -> None:
        """Hear the page with this token and no other; none if it is empty."""
        with self._lock:
            self._token = token
            self._replace_driver(None)

    def take(self) -> Held | None:
        """Return the newest that is held; None if nothing has come since the last call."""
        with self._lock:
            newest, self._newest = self._newest, None
        return newest

    def _replace_driver(self, connection: ServerConnection | None) -> None:
        """Hear another connection, with the lock taken; the one before has let go of all."""
        if self._driver is not None:
            _hang_up(self._driver.socket)
        self._driver, self._newest = connection, Held()

    def _let_in(self) -> None:
        """Accept connections until the end: not too fast, and few at once."""
        while not self._closed:
            with suppress(OSError):  # nobody came for a second, or they hung up at once
                connection, address = self._server.socket.accept()
                self._others[connection] = time.monotonic()
                Thread(target=self._serve, args=(connection, address), daemon=True).start()
            others, now = list(self._others.items()), time.monotonic()
            for i, (other, begin) in enumerate(others):
                if i < len(others) - _MOST_CONNECTIONS or now - begin > _LIFETIME:
                    self._others.pop(other, None)
                    _hang_up(other)
            time.sleep(_PAUSE)

    def _serve(self, connection: socket.socket, address: object) -> None:
        try:
            self._server.handler(connection, address)
        finally:
            self._others.pop(connection, None)

    def _hear(self, connection: ServerConnection) -> None:
        """Hear the driver until the connection ends; that lets go of all."""
        self._others.pop(connection.socket, None)
        assert connection.request is not None
        with self._lock:
            if not self._is_drivers(connection.request.path):
                return
            self._replace_driver(connection)
        try:
            for message in connection:
                held = held_of(message, time.monotonic())
                with self._lock:
                    if self._driver is not connection:
                        return
                    self._newest = held or self._newest
                connection.send(str(time.monotonic()))
                time.sleep(_PAUSE)
        except ConnectionClosed:
            pass
        finally:
            with self._lock:
                if self._driver is connection:
                    self._replace_driver(None)

    def _is_drivers(self, path: str) -> bool:
        """Whether an address carries the driver's token."""
        return self._token != '' and parse_qs(urlsplit(path).query).get('token') == [self._token]

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request for a page; None lets the driver's connection through."""
        try:
            host, origin, asked = _parts(request)
        except (ValueError, MultipleValuesError):
            return _text(http.HTTPStatus.BAD_REQUEST,
                         'the path, Host or Origin of this request is malformed; open '
                         f'{self.url}')
        name = host.hostname
        # A page of another site must not drive the arm, nor pretend to be this one by its name.
        if self._host in _LOOPBACK and name not in _LOOPBACK:
            return _text(http.HTTPStatus.FORBIDDEN, 'open this page as localhost')
        if asked.path == '/held':
            is_ours = origin.netloc == host.netloc
            return None if is_ours and self._is_drivers(request.path) else _text(
                http.HTTPStatus.FORBIDDEN, "this is for the driver's page alone")
        if asked.path.startswith('/report/'):
            file = self.reports.get(unquote(asked.path.removeprefix('/report/')))
            if file is None or not file.is_file():
                return _text(http.HTTPStatus.NOT_FOUND, 'there is no such report')
            return _html(file.read_bytes())
        if asked.path != '/':
            return _text(http.HTTPStatus.NOT_FOUND, 'there is nothing here')
        shown = f'[{name}]' if name and ':' in name else name
        there = f'ws://{shown}:{self._viser_port}'
        if parse_qs(asked.query).get('websocket') != [there]:
            return Response(http.HTTPStatus.FOUND, 'Found', Headers({
                'Location': f'/?websocket={quote(there, safe="")}', 'Content-Length': '0'}))
        return _html(self._page)


def _parts(request: Request) -> tuple[SplitResult, SplitResult, SplitResult]:
    """Return the Host, the Origin, empty if it is none, and the path of a request.

    Raises:
        ValueError, MultipleValuesError: one of them is malformed.
    """
    named, origin = request.headers.get('Host', ''), request.headers.get('Origin', 'null')
    host, asked = urlsplit(f'//{named}'), urlsplit(request.path)
    site = urlsplit('' if origin == 'null' else origin)
    if (not host.hostname or host.netloc != named or host.port == 0
            or not (site.netloc or origin == 'null') or not asked.path.startswith('/')):
        raise ValueError
    return host, site, asked


def _hang_up(connection: socket.socket) -> None:
    """End a connection; its threads see that and end."""
    with suppress(OSError):  # it has ended by itself
        connection.shutdown(socket.SHUT_RDWR)


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

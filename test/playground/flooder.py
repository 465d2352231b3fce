"""A watcher that floods the page: `python flooder.py PORT`, until it is ended.

It begins as a page does, and sends as fast as it can that a key is held, whatever the answer is.
Where it is hung up it comes again.
"""

from __future__ import annotations

from contextlib import suppress
import json
import socket
import sys


def main():
    port = int(sys.argv[1])
    own = f'localhost:{port}'
    request = '\r\n'.join((
        'GET /held?token=wrong HTTP/1.1', f'Host: {own}', f'Origin: http://{own}',
        'Upgrade: websocket', 'Connection: Upgrade', 'Sec-WebSocket-Version: 13',
        'Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==', '', '')).encode()
    message = json.dumps({'token': 'wrong', 'clock': 1e9, 'keys': ['KeyW'], 'pad': None}).encode()
    # A text frame whose mask is zero.
    frames = 100 * (bytes((0x81, 0x80 | len(message), 0, 0, 0, 0)) + message)
    while True:
        with suppress(OSError), socket.create_connection(('127.0.0.1', port), 10) as page:
            page.sendall(request)
            while True:
                page.sendall(frames)


if __name__ == '__main__':
    main()

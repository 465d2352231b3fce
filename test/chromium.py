"""A headless Chromium, told what to do over its debugging protocol."""

from __future__ import annotations

import base64
import itertools
import json
import os
from pathlib import Path
import shutil
import signal
import subprocess
import tempfile
import time
import urllib.request

from websockets.sync.client import connect

BROWSERS = ('chromium', 'chromium-browser', 'google-chrome')
# What is no fault of a page's: viser's own listeners say it of every drag.
_HARMLESS = 'Unable to preventDefault inside passive event listener'
# A page on a busy machine without graphics may take this long [s].
PATIENCE = 120.0
_SWITCHES = (
    '--headless=new', '--no-sandbox', '--disable-gpu-sandbox', '--use-angle=swiftshader',
    '--enable-unsafe-swiftshader', '--no-first-run', '--disable-extensions',
    '--disable-background-networking', '--remote-debugging-port=0')
_CODES = {**{f'Key{letter.upper()}': letter for letter in 'abcdefghijklmnopqrstuvwxyz'},
          'Space': ' ', 'ShiftLeft': 'Shift'}


def browser() -> str | None:
    """Return a Chromium of this machine, None if there is none."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


class Chromium:
    """The browser's process; none outlives the `with` block."""

    def __init__(self, width=1100, height=640):
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._process = subprocess.Popen(
            [browser(), *_SWITCHES, f'--user-data-dir={self._folder.name}',
             f'--window-size={width},{height}', 'about:blank'],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        file = Path(self._folder.name) / 'DevToolsActivePort'
        deadline = time.monotonic() + PATIENCE
        while not file.exists() or len(file.read_text().split()) < 2:
            assert time.monotonic() < deadline, 'the browser does not start'
            assert self._process.poll() is None, 'the browser has ended'
            time.sleep(0.1)
        self._port = file.read_text().split()[0]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        os.killpg(self._process.pid, signal.SIGKILL)  # with all that it has started
        self._process.wait()
        self._folder.cleanup()

    def open(self, url):
        """Open a page."""
        request = urllib.request.Request(
            f'http://127.0.0.1:{self._port}/json/new?about:blank', method='PUT')
        with urllib.request.urlopen(request) as answer:
            page = Page(json.load(answer)['webSocketDebuggerUrl'])
        page.go_to(url)
        return page


class Page:
    """One tab. `errors` are those of its console, and exceptions that nothing caught."""

    def __init__(self, address):
        self._connection = connect(address, max_size=None, open_timeout=PATIENCE)
        self._numbers = itertools.count(1)
        self.errors = []
        for domain in ('Page', 'Runtime', 'Log'):
            self.call(f'{domain}.enable')

    def call(self, method, **parameters):
        """Call a method of the protocol, and return its result."""
        number = next(self._numbers)
        self._connection.send(json.dumps(
            {'id': number, 'method': method, 'params': parameters}))
        while True:
            message = json.loads(self._connection.recv(timeout=PATIENCE))
            if message.get('id') == number:
                assert 'error' not in message, f'{method}: {message["error"]}'
                return message['result']
            self._note(message)

    def _note(self, message):
        parameters = message.get('params', {})
        if message['method'] == 'Runtime.exceptionThrown':
            details = parameters['exceptionDetails']
            self.errors.append(details.get('exception', {}).get('description', details['text']))
        elif message['method'] == 'Runtime.consoleAPICalled' and parameters['type'] == 'error':
            self.errors.append(' '.join(
                str(one.get('value', one.get('description'))) for one in parameters['args']))
        elif message['method'] == 'Log.entryAdded':
            entry = parameters['entry']
            if entry['level'] == 'error' and _HARMLESS not in entry['text']:
                self.errors.append(f"{entry['text']} {entry.get('url', '')}")

    def go_to(self, url):
        """Load a page in this tab."""
        self.call('Page.navigate', url=url)

    def value(self, expression):
        """Return what an expression is in the page, as JSON has it."""
        answer = self.call('Runtime.evaluate', expression=expression, returnByValue=True,
                           awaitPromise=True)
        assert 'exceptionDetails' not in answer, answer['exceptionDetails']
        return answer['result'].get('value')

    def wait_for(self, expression, patience=PATIENCE):
        """Wait until an expression is true in the page."""
        deadline = time.monotonic() + patience
        while not self.value(f'!!({expression})'):
            assert time.monotonic() < deadline, f'never: {expression}; {self.errors}'
            time.sleep(0.1)

    def key(self, code, *, down):
        """Press a key, or let go of it."""
        self.call('Input.dispatchKeyEvent', type='keyDown' if down else 'keyUp', code=code,
                  key=_CODES.get(code, code))

    def mouse(self, kind, x, y, *, held=False):
        """Send `mousePressed`, `mouseMoved` or `mouseReleased` at a place [px]."""
        self.call('Input.dispatchMouseEvent', type=kind, x=x, y=y, button='left',
                  buttons=int(held), clickCount=1)

    def click(self, x, y):
        """Click at a place [px]."""
        self.mouse('mouseMoved', x, y)
        self.mouse('mousePressed', x, y, held=True)
        self.mouse('mouseReleased', x, y)

    def picture(self, file):
        """Write what the page looks like to a PNG."""
        data = self.call('Page.captureScreenshot', format='png')['data']
        Path(file).write_bytes(base64.b64decode(data))

    def close(self):
        """Close the tab."""
        self.call('Page.close')
        self._connection.close()

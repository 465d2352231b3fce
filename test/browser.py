"""Opens a page in a headless Chromium (Qt WebEngine) and says what it saw, as JSON.

Run as a process of its own: browser.py PAGE WIDTH HEIGHT FOLDER. Screenshots go to the folder,
one before the 3-D view plays and one while it does.
"""

from __future__ import annotations

import json
import os
import sys

os.environ['QT_QPA_PLATFORM'] = 'offscreen'
os.environ['QTWEBENGINE_DISABLE_SANDBOX'] = '1'
os.environ['QTWEBENGINE_CHROMIUM_FLAGS'] = (
    '--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --ignore-gpu-blocklist')

from PySide6.QtCore import QTimer, QUrl
from PySide6.QtWebEngineCore import QWebEnginePage
from PySide6.QtWebEngineWidgets import QWebEngineView
from PySide6.QtWidgets import QApplication

ERROR = QWebEnginePage.JavaScriptConsoleMessageLevel.ErrorMessageLevel
# The page may take this long to be drawn; after that the view plays for a while [ms].
PATIENCE, STEP, PLAYING = 60_000, 500, 1500


class Page(QWebEnginePage):
    """Keeps the errors of the console."""

    def __init__(self):
        """Begin without errors."""
        super().__init__()
        self.errors = []

    def javaScriptConsoleMessage(self, level, message, line, source):  # noqa: N802 (Qt's name)
        """Keep an error."""
        if level == ERROR:
            self.errors.append(message)


def main():
    """Open the page; return the process's exit status."""
    file, width, height, folder = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
    application = QApplication(sys.argv[:1])
    view, page = QWebEngineView(), Page()
    view.setPage(page)
    view.resize(width, height)
    view.load(QUrl.fromLocalFile(file))
    view.show()
    seen = {}

    def wait_until_drawn():
        page.runJavaScript(
            "document.querySelectorAll('#view0 canvas').length > 0 && clock0.textContent",
            0, lambda clock: start() if clock else QTimer.singleShot(STEP, wait_until_drawn))

    def start():
        seen['before'] = folder + '/before.png'
        page.runJavaScript('view0.scrollIntoView()')
        QTimer.singleShot(STEP, lambda: (view.grab().save(seen['before']), play()))

    def play():
        page.runJavaScript('play0.click(); document.documentElement.scrollWidth', 0,
                           lambda width: seen.update(scroll_width=width))
        QTimer.singleShot(PLAYING, finish)

    def finish():
        seen['after'] = folder + '/after.png'
        view.grab().save(seen['after'])
        page.runJavaScript('clock0.textContent + "|" + document.scripts.length', 0, end)

    def end(counted):
        clock, scripts = counted.split('|')
        print(json.dumps({**seen, 'clock': clock, 'scripts': int(scripts),
                          'errors': page.errors}))
        application.quit()

    QTimer.singleShot(STEP, wait_until_drawn)
    QTimer.singleShot(PATIENCE, lambda: application.exit(1))
    return application.exec()


if __name__ == '__main__':
    raise SystemExit(main())

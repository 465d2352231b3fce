"""Takes the picture of a report, in the middle of its motion.

By hand: `PYTHONPATH=test python test/analysis/draw_report.py REPORT.html PICTURE.png`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from chromium import Chromium

# Of the picture [px].
WIDTH, HEIGHT = 1280, 1500
# The 3-D views are there, drawn by WebGL.
DRAWN = "document.querySelectorAll('.view canvas').length > 0"
# A moment late in the motion, so that there is a trail to see.
MOVE = """new Promise((done) => {
    seek(slider0.min / 1000 + 0.6 * (slider0.max - slider0.min) / 1000);
    requestAnimationFrame(() => setTimeout(done, 2000));
})"""


def main():
    """Open the report and take the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('report', type=Path)
    parser.add_argument('picture', type=Path)
    parser.add_argument('--dark', action='store_true')
    options = parser.parse_args()
    with Chromium() as chromium:
        page = chromium.open('about:blank')
        page.call('Emulation.setDeviceMetricsOverride', width=WIDTH, height=HEIGHT,
                  deviceScaleFactor=1, mobile=False)
        page.call('Emulation.setEmulatedMedia', features=[
            {'name': 'prefers-color-scheme', 'value': 'dark' if options.dark else 'light'}])
        page.call('Emulation.setScrollbarsHidden', hidden=True)
        page.go_to(options.report.resolve().as_uri())
        page.wait_for(DRAWN)
        page.value(MOVE)
        page.picture(options.picture)
        assert not page.errors, page.errors


if __name__ == '__main__':
    main()

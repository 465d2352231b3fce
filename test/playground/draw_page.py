"""Takes the picture of docs/playground.md.

By hand: `PYTHONPATH=test python test/playground/draw_page.py`.
"""

from __future__ import annotations

from pathlib import Path
import tempfile
import time

from chromium import Chromium
import numpy as np
from test_page import playground, ready

FIGURES = Path(__file__).resolve().parent.parent.parent / 'docs' / 'figures'


def main():
    """Drive a little, so that there is a trail, and take the picture in motion."""
    with tempfile.TemporaryDirectory() as folder, playground(Path(folder)) as (arm, url), (
            Chromium(1280, 760)) as chromium:
        page = chromium.open(url)
        ready(page)
        for key, axis, way in (('KeyE', 2, -0.12), ('KeyD', 1, -0.12), ('KeyA', 1, 0.25)):
            begin = arm.tip
            page.key(key, down=True)
            arm.wait_for(lambda b=begin, a=axis, w=way: (arm.tip - b)[a] / w > 1.0, 'motion')
            if way < 0.0:
                page.key(key, down=False)
                time.sleep(1.0)
        page.value("""[...document.querySelectorAll('button')].filter((button) =>
            button.closest('[role=alert]')).forEach((button) => button.click())""")
        page.picture(FIGURES / 'playground.png')
        page.key('KeyA', down=False)
        assert np.isfinite(arm.tip).all()


if __name__ == '__main__':
    main()

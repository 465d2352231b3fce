"""The driver's other controls: scenes, the ghost to compare with, bags, and what is shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import html
from typing import Any, NamedTuple
from urllib.parse import quote

import viser

from redundant_planner.playground.ghost import METHODS_TO_COMPARE
from redundant_planner.playground.recordings import Recordings
from redundant_planner.playground.scenes import PageScene

_NOBODY = 'nothing'


class Granted(NamedTuple):
    """What the driver's choices are handed to.

    Attributes:
        load: takes the chosen scene.
        drive: takes the number of the arm that is to be driven.
        compare: takes the method to compare with, empty for none.
        record: takes whether to record.
        show: takes whether links and capsules are to be seen.
    """

    load: Callable[[PageScene], object]
    drive: Callable[[int], object]
    compare: Callable[[str], object]
    record: Callable[[bool], object]
    show: Callable[[bool, bool], object]


class MoreControls:
    """What the driver chooses besides."""

    def __init__(
        self, client: viser.ClientHandle, later: Callable[..., None],
        scenes: Sequence[PageScene], shown: PageScene | None, arms: Sequence[str],
        granted: Granted,
    ) -> None:
        """Put the controls on the driver's page.

        Args:
            client: the driver.
            later: has a function called in the loop of the page, with its arguments.
            scenes: to choose from.
            shown: the one that is shown; None where the page does not run the arm.
            arms: names of the arms.
            granted: what choices are handed to.
        """
        gui: Any = client.gui  # where mypy takes values for read-only
        titles = {scene.title: scene for scene in scenes}
        if shown is not None:
            with gui.add_folder('Scene', order=1):
                self._hint = gui.add_markdown(shown.hint)
                choice = gui.add_dropdown(
                    'scene', tuple(titles), initial_value=shown.title)
                loading = gui.add_button('Load it anew')

            async def loads(event: Any) -> None:
                if event.client_id is not None:
                    self._hint.content = titles[choice.value].hint
                    later(granted.load, titles[choice.value])

            choice.on_update(loads)
            loading.on_click(loads)
        if len(arms) > 1:
            arm = gui.add_dropdown('drive the arm', tuple(arms), order=1.5)

            async def drives(event: Any) -> None:
                later(granted.drive, tuple(arms).index(event.target.value))

            arm.on_update(drives)
        with gui.add_folder('Compare', order=4, expand_by_default=False):
            method = gui.add_dropdown('ghost by', (_NOBODY, *METHODS_TO_COMPARE))
            again = gui.add_button('Begin again here')
        with gui.add_folder('Record', order=5, expand_by_default=False):
            self._recording = gui.add_checkbox('record a bag', False)
            self._said = gui.add_html('')
        with gui.add_folder('View', order=6, expand_by_default=False):
            links = gui.add_checkbox('links', True)
            capsules = gui.add_checkbox('capsules', False)

        async def compares(event: Any) -> None:
            later(granted.compare, '' if method.value == _NOBODY else str(method.value))

        async def records(event: Any) -> None:
            if event.client_id is not None:
                later(granted.record, bool(event.target.value))

        async def shows(event: Any) -> None:
            later(granted.show, bool(links.value), bool(capsules.value))

        method.on_update(compares)
        again.on_click(compares)
        self._recording.on_update(records)
        links.on_update(shows)
        capsules.on_update(shows)

    def show_recordings(self, recordings: Recordings) -> None:
        """Say what became of bags, and link their reports."""
        if self._recording.value != recordings.is_on:
            self._recording.value = recordings.is_on
        links = ''.join(
            f'<div><a href="/report/{quote(name)}" target="_blank">{html.escape(name)}</a></div>'
            for name in recordings.reports)
        content = (f'<div style="font-size:12px;padding:0 .6em" data-recordings>'
                   f'{html.escape(recordings.says)}{links}</div>')
        if self._said.content != content:
            self._said.content = content

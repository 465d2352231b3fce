"""viser's server, whose port leads whoever opens it to the page.

viser prints a frame with its own address, where its client without our script is: a page on which
no key drives anything. Both are hidden here, by what viser 1.1 has inside; with another one that
has it elsewhere the page works all the same.
"""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from pathlib import Path
from typing import Any

import rich
import viser

_INDEX = 'index.html'


def viser_server(host: str, port: int, folder: Path) -> viser.ViserServer:
    """Start viser's server without a word of it.

    Args:
        host: address to listen on.
        port: to listen on, or the next free one; 0 for any.
        folder: whose files are served there, see `lead_to`.
    """
    # It prints where it listens, and that it has stopped, whether verbose or not.
    rich.get_console().quiet = True
    with _files_from(folder):
        return viser.ViserServer(host=host, port=port, label='redundant_planner', verbose=False)


def lead_to(page_port: int, folder: Path) -> None:
    """Have viser's port lead to the page on another port of the same host."""
    (folder / _INDEX).write_text(
        '<!doctype html><title>redundant_planner playground</title>'
        '<script>location.replace(`${location.protocol}//${location.hostname}:'
        f'{page_port}/`)</script>'
        f'<p>The playground is on port {page_port} of this host.</p>', encoding='utf-8')


@contextlib.contextmanager
def _files_from(folder: Path) -> Iterator[None]:
    """Have a server that is made meanwhile serve the files of a folder."""
    infra: Any = getattr(viser, 'infra', None)
    kind = getattr(infra, 'WebsockServer', None)
    if kind is None:
        yield
        return

    class Elsewhere(kind):  # type: ignore[misc, valid-type]
        """A server of another folder's files."""

        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options | {'http_server_root': folder})

    infra.WebsockServer = Elsewhere
    try:
        yield
    finally:
        infra.WebsockServer = kind

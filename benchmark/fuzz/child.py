"""A process in which attacks run, one after another, and which they may kill."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
import faulthandler
import multiprocessing
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import signal
import tempfile

import numpy as np

from benchmark.fuzz.tally import PATIENCE, Tally

# An attack draws from its own generator, writes to its own folder and counts into the tally.
Attack = Callable[[np.random.Generator, Path, Tally], None]

# An attack that has not ended after so long hangs where Python cannot end it [s].
_LONGEST_ATTACK = 10.0 * PATIENCE
# How long a process that hangs may take to say where [s].
_LAST_WORDS = 5.0
# How much of what a process wrote at last is kept [bytes].
_MOST_WORDS = 6000
# The file descriptor to which the C library writes, too.
_STDERR = 2


class Child:
    """Runs attacks of one kind in a process of its own, and in a new one after each death.

    The process is forked from this one, which has imported what is attacked and run none of it:
    every new process begins as the first did, at once. What lives across attacks within it, lives
    on: damage that one does to memory shows in those after it.
    """

    def __init__(self, attack: Attack, seed: tuple[int, ...]) -> None:
        """Prepare to run an attack by numbers; its generator depends on the seed and these."""
        self._attack, self._seed = attack, seed
        self._folder = tempfile.TemporaryDirectory()
        self._words = Path(self._folder.name) / 'last words'
        self._process: BaseProcess | None = None

    def __enter__(self) -> Child:
        """Return itself; processes begin as they are needed."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the process, and remove what attacks have written."""
        self._end(signal.SIGKILL)
        self._folder.cleanup()

    def run(self, number: int) -> Tally:
        """Run one attack; return what it counted. A death counts, whatever it had counted not."""
        if self._process is None:
            self._begin(number)
        assert self._process is not None
        tally, hangs = Tally(number), False
        try:
            self._pipe.send(number)
            if self._pipe.poll(_LONGEST_ATTACK):
                found: Tally = self._pipe.recv()
                return found
            hangs = True
        except (EOFError, OSError):
            pass  # it has died
        process, since = self._process, self._since
        # SIGABRT lets it write where it hangs.
        self._end(signal.SIGABRT if hangs else None)
        assert process.exitcode is not None
        how = (f'hanging for {_LONGEST_ATTACK:g} s' if hangs
               else signal.Signals(-process.exitcode).name if process.exitcode < 0
               else f'exit status {process.exitcode}')
        tally.died(how, f'in a process that began with attack {since}\n{self._last_words()}')
        return tally

    def _begin(self, number: int) -> None:
        context = multiprocessing.get_context('fork')
        self._pipe, there = context.Pipe()
        self._words.write_bytes(b'')
        self._since = number
        self._process = context.Process(target=self._serve, args=(there,))
        self._process.start()
        there.close()

    def _end(self, by: signal.Signals | None) -> None:
        """Wait for the process to have ended, helped by a signal."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.pid is not None
        if by is not None:
            os.kill(process.pid, by)
        process.join(_LAST_WORDS)
        if process.is_alive():
            process.kill()
            process.join()
        self._pipe.close()

    def _serve(self, there: Connection) -> None:
        """Run the attacks that are asked for. In the new process."""
        self._pipe.close()  # so that this process ends when the other one does
        os.dup2(os.open(self._words, os.O_WRONLY | os.O_APPEND), _STDERR)
        faulthandler.enable(_STDERR)
        with contextlib.suppress(EOFError):
            while True:
                number = there.recv()
                tally = Tally(number)
                with tempfile.TemporaryDirectory(dir=self._folder.name) as folder:
                    self._attack(
                        np.random.default_rng((*self._seed, number)), Path(folder), tally)
                there.send(tally)

    def _last_words(self) -> str:
        return self._words.read_bytes()[-_MOST_WORDS:].decode(errors='replace')

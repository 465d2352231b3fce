"""Bags of what happens on the page, and the reports of them."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
import signal
import subprocess
import sys

# What a recorder or an analysis says last is kept to be shown, up to this length.
_LONGEST = 400


class Recordings:
    """Records with record_bag, and makes reports with analyze_bag, as processes of their own.

    Attributes:
        reports: name → file of each finished report.
        says: one sentence about the latest recording.
    """

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        """Prepare.

        Args:
            folder: where bags and reports go; made when the first one begins.
            environment: of the processes.
        """
        self.reports: dict[str, Path] = {}
        self.says = ''
        self._folder, self._environment = folder, dict(environment)
        self._bag: Path | None = None
        self._recorder: subprocess.Popen[bytes] | None = None
        self._analyses: dict[str, subprocess.Popen[bytes]] = {}

    @property
    def is_on(self) -> bool:
        """Whether it records."""
        return self._recorder is not None

    def begin(self, planner: str, namespace: str) -> None:
        """Begin a bag; planner and namespace as for `PlannerClient`."""
        if self._recorder is not None:
            return
        self._folder.mkdir(parents=True, exist_ok=True)
        self._bag = self._folder / datetime.now().strftime('bag_%Y_%m_%d-%H_%M_%S')
        remap = ['--ros-args', '-r', f'__ns:={namespace}'] if namespace else []
        self._recorder = self._process('record_bag', str(self._bag), '--planner', planner, *remap)
        self.says = f'recording to {self._bag}'

    def end(self) -> None:
        """End the bag, and begin its report."""
        if self._recorder is None or self._bag is None:
            return
        self._recorder.send_signal(signal.SIGINT)
        try:
            self._recorder.wait(5.0)
        except subprocess.TimeoutExpired:
            self._recorder.kill()
        self._recorder = None
        name = self._bag.name
        self._analyses[name] = self._process(
            'analyze_bag', str(self._bag), '--report', str(self._folder / f'report_{name}'))
        self.says = f'{self._bag} is closed; its report is being made'

    def look(self) -> None:
        """Take in what has been finished."""
        if self._recorder is not None and self._recorder.poll() is not None:
            self.says = f'the recording ended by itself: {_last_words(self._recorder)}'
            self._recorder = None
        for name, analysis in list(self._analyses.items()):
            if analysis.poll() is None:
                continue
            del self._analyses[name]
            pages = sorted((self._folder / f'report_{name}').glob('*.html'))
            if analysis.returncode == 0 and pages:
                self.reports[name] = pages[0]
                self.says = f'the report of {name} is ready'
            else:
                self.says = f'{name} has no report: {_last_words(analysis)}'

    def close(self) -> None:
        """End all."""
        if self._recorder is not None:
            self._recorder.send_signal(signal.SIGINT)
            try:
                self._recorder.wait(5.0)
            except subprocess.TimeoutExpired:
                self._recorder.kill()
        for analysis in self._analyses.values():
            analysis.terminate()

    def _process(self, tool: str, *arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, '-m', f'redundant_planner.tools.{tool}', *arguments],
            env=self._environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, start_new_session=True)


def _last_words(process: subprocess.Popen[bytes]) -> str:
    """Return what a process that has ended wrote last."""
    said = process.stderr.read().decode(errors='replace').strip() if process.stderr else ''
    return said[-_LONGEST:] or f'exit status {process.returncode}'

"""A bag's file of the sqlite3 storage, read without trust in what it says of itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
import sqlite3
import sys
from urllib.parse import quote

from redundant_planner.io.bag_storage import LATEST, Message, RecordingError
from redundant_planner.io.printable import printable

SQLITE = b'SQLite format 3\0'


class SqliteFile:
    """A file of the sqlite3 storage: the tables topics and messages."""

    def __init__(self, path: Path) -> None:
        """Count what is in the file.

        Raises:
            RecordingError: it is no such file.
        """
        self.path = path
        self.topics: dict[int, tuple[str, str]] = {}
        self.counts: Counter[int] = Counter()
        self.begin_ns, self.end_ns = LATEST, -1
        self.problems: list[str] = []
        self._sound = True
        try:
            self._database = self._opened()
            self._count()
        except sqlite3.Error as error:
            raise RecordingError(f"'{path}' is not a readable bag: {error}") from None

    def _opened(self) -> sqlite3.Connection:
        database = sqlite3.connect(
            f'file:{quote(str(self.path.resolve()))}?mode=ro&immutable=1', uri=True,
            check_same_thread=False)
        database.text_factory = lambda text: text.decode(errors='replace')
        if sys.version_info >= (3, 11):
            # Nothing in a file is longer than the file, whatever an expression makes of it.
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH,
                              max(self.path.stat().st_size, 1_000_000))
        database.execute('PRAGMA trusted_schema = OFF')
        # Without it sqlite refuses a file that was cut off; nothing is written either way.
        database.execute('PRAGMA writable_schema = ON')
        tables = {name for name, in database.execute(
            "SELECT name FROM sqlite_master WHERE type = 'table' AND sql NOT LIKE '%VIRTUAL%'")}
        if not {'topics', 'messages'} <= tables:
            raise RecordingError(
                f"'{self.path}' is not a readable bag: it has no tables 'topics' and 'messages'")
        return database

    def _count(self) -> None:
        for channel, topic, kind in self._database.execute('SELECT id, name, type FROM topics'):
            if isinstance(channel, int):
                self.topics[channel] = printable(str(topic)), printable(str(kind))
        impossible = 0
        try:
            for channel, time in self._database.execute(
                    'SELECT topic_id, timestamp FROM messages'):
                if _possible(channel, time):
                    self.counts[channel] += 1
                    self.begin_ns, self.end_ns = min(self.begin_ns, time), max(self.end_ns, time)
                else:
                    impossible += 1
        except sqlite3.Error as error:
            self._sound = False
            self.problems.append(f'the bag is damaged, and read as far as it goes: {error}')
        if impossible:
            self.problems.append(f'{impossible} messages of an impossible time are left out')

    def messages(self, chosen: Collection[int], first: int, last: int) -> Iterator[Message]:
        """Yield the messages of some channels with first ≤ time < last [ns], in order of time."""
        query = ('SELECT topic_id, timestamp, data FROM messages WHERE timestamp >= ? AND '
                 f'timestamp < ? AND topic_id IN ({",".join(str(channel) for channel in chosen)})')
        found = False
        # To sort them, all of them must be readable; if not, they come as they were written.
        for order in (' ORDER BY timestamp', '') if self._sound else ('',):
            try:
                for channel, time, raw in self._database.execute(
                        query + order, (first, min(last, LATEST))):
                    if _possible(channel, time) and isinstance(raw, bytes):
                        found = True
                        yield channel, time, raw
                return
            except sqlite3.Error as error:
                problem = f'the bag is damaged, and read as far as it goes: {error}'
                self.problems += [problem] if problem not in self.problems else []
                if found:
                    return


def _possible(channel: object, time: object) -> bool:
    return isinstance(channel, int) and isinstance(time, int) and 0 <= time < LATEST

"""Which version of the package made a bag: a comment above the recorded configuration."""

from __future__ import annotations

from pathlib import Path
import re

from redundant_planner import __version__

PACKAGE = 'redundant_planner'
_ROOT = Path(__file__).resolve().parents[2]
_LINE = re.compile(r'# redundant_planner (?P<version>[\w.+-]{1,40})'
                   r'(?:, commit (?P<commit>[0-9a-f]{7,64}))?\r?\n')
_COMMIT = re.compile(r'[0-9a-f]{40}(?:[0-9a-f]{24})?')
# Of a commit's name, as git shows it.
_SHORT = 10


def with_version(configuration: str, root: Path = _ROOT) -> str:
    """Return a configuration below a YAML comment that says which version wrote it."""
    commit = checked_out_commit(root)
    told = f', commit {commit[:_SHORT]}' if commit else ''
    return f'# {PACKAGE} {__version__}{told}\n{configuration}'


def version_of(configuration: str) -> str:
    """Return the version that wrote a recorded configuration; empty if it does not say."""
    found = _LINE.match(configuration)
    if found is None:
        return ''
    commit = found['commit']
    return found['version'] + (f', commit {commit}' if commit else '')


def checked_out_commit(root: Path) -> str:
    """Return the commit that a folder is a checkout of; empty if it is none.

    It reads git's files and starts no process, for a node asks before its loop begins.
    """
    try:
        folder = root / '.git'
        if folder.is_file():  # a worktree's: its folder lies elsewhere
            folder = root / folder.read_text().removeprefix('gitdir:').strip()
        head = (folder / 'HEAD').read_text().strip()
        if head.startswith('ref:'):
            head = _commit_of_branch(folder, head.removeprefix('ref:').strip())
    except (OSError, ValueError):
        return ''
    return head if _COMMIT.fullmatch(head) else ''


def _commit_of_branch(folder: Path, branch: str) -> str:
    shared = folder / 'commondir'
    common = folder / shared.read_text().strip() if shared.is_file() else folder
    if (common / branch).is_file():
        return (common / branch).read_text().strip()
    for line in (common / 'packed-refs').read_text().splitlines():
        commit, _, name = line.partition(' ')
        if name == branch:
            return commit
    return ''

"""A recorded configuration says which version wrote it, and stays the YAML that it was."""

from __future__ import annotations

import pytest
import yaml

from redundant_planner import __version__
from redundant_planner.io.software_version import checked_out_commit, version_of, with_version

COMMIT = '0123456789abcdef0123456789abcdef01234567'
TEXT = '/**:\n  ros__parameters:\n    rate: 250.0\n'


def checkout(folder, head, branch=''):
    (folder / '.git' / 'refs' / 'heads').mkdir(parents=True)
    (folder / '.git' / 'HEAD').write_text(head + '\n')
    if branch:
        (folder / '.git' / 'refs' / 'heads' / 'main').write_text(branch + '\n')
    return folder


def test_what_was_written_is_read_back(tmp_path):
    text = with_version(TEXT, checkout(tmp_path, COMMIT))
    assert version_of(text) == f'{__version__}, commit 0123456789'
    assert yaml.safe_load(text) == yaml.safe_load(TEXT)


def test_outside_a_checkout_there_is_a_version_alone(tmp_path):
    assert version_of(with_version(TEXT, tmp_path)) == __version__


def test_the_commit_of_a_branch(tmp_path):
    assert checked_out_commit(checkout(tmp_path, 'ref: refs/heads/main', COMMIT)) == COMMIT


def test_the_commit_of_a_packed_branch(tmp_path):
    checkout(tmp_path, 'ref: refs/heads/main')
    (tmp_path / '.git' / 'packed-refs').write_text(
        f'# pack-refs with: peeled\n{"f" * 40} refs/heads/other\n{COMMIT} refs/heads/main\n')
    assert checked_out_commit(tmp_path) == COMMIT


def test_the_commit_of_a_worktree(tmp_path):
    whole = checkout(tmp_path / 'whole', 'ref: refs/heads/elsewhere', COMMIT)
    own = whole / '.git' / 'worktrees' / 'second'
    own.mkdir(parents=True)
    (own / 'HEAD').write_text('ref: refs/heads/main\n')
    (own / 'commondir').write_text('../..\n')
    second = tmp_path / 'second'
    second.mkdir()
    (second / '.git').write_text(f'gitdir: {own}\n')
    assert checked_out_commit(second) == COMMIT


@pytest.mark.parametrize('head', ['', 'ref: refs/heads/none', 'ref: ../../HEAD', 'not a commit',
                                  COMMIT[:-1]])
def test_a_damaged_checkout_has_no_commit(tmp_path, head):
    assert checked_out_commit(checkout(tmp_path, head)) == ''


@pytest.mark.parametrize('line', [
    '', '/**:', '# redundant_planner', '# redundant_planner <b>', '# another_planner 1.0',
    f'# redundant_planner 0.1.0, commit {COMMIT} and more', '# redundant_planner ' + '1' * 99])
def test_another_first_line_says_nothing(line):
    assert version_of(f'{line}\n{TEXT}') == ''

"""Whose cache is believed."""

from __future__ import annotations

import os

import pytest

from redundant_planner.core.cache_folder import cache_folder


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.delenv('XDG_CACHE_HOME', raising=False)
    monkeypatch.setenv('HOME', str(tmp_path))
    return tmp_path


def test_it_lies_in_the_home_or_where_the_user_says(home, monkeypatch):
    folder = cache_folder()
    assert folder == home / '.cache' / 'redundant_planner'
    assert folder.stat().st_mode & 0o777 == 0o700
    monkeypatch.setenv('XDG_CACHE_HOME', str(home / 'elsewhere'))
    assert cache_folder() == home / 'elsewhere' / 'redundant_planner'
    # The standard has relative paths ignored.
    monkeypatch.setenv('XDG_CACHE_HOME', 'here')
    assert cache_folder() == folder


@pytest.mark.parametrize('where', ['~', 'here', '', '/dev/null/home'])
def test_without_a_home_there_is_none_and_nothing_is_made(home, monkeypatch, where):
    monkeypatch.chdir(home)
    monkeypatch.setenv('HOME', where)
    monkeypatch.setattr(os.path, 'expanduser', lambda path: path.replace('~', where))
    assert cache_folder() is None
    assert list(home.iterdir()) == []


@pytest.mark.parametrize('mode', [0o770, 0o707, 0o777, 0o1777])
def test_a_folder_that_others_can_write_to_is_not_believed(home, mode):
    cache_folder().chmod(mode)
    assert cache_folder() is None


def test_somebody_elses_folder_is_not_believed(home, monkeypatch):
    folder = cache_folder()
    monkeypatch.setattr(os, 'getuid', lambda: folder.stat().st_uid + 1)
    assert cache_folder() is None


def test_a_file_in_its_place_is_no_folder(home):
    (home / '.cache').write_text('')
    assert cache_folder() is None

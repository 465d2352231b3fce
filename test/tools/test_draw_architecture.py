"""The picture of the rooms is drawn from the code, and shows the code as it is."""

from __future__ import annotations

from pathlib import Path
import sys

import pytest

from redundant_planner.tools import draw_architecture

DOCS = Path(__file__).resolve().parent.parent.parent / 'docs'


def test_the_page_lists_the_imports_of_the_code():
    page = (DOCS / 'architecture.md').read_text()
    assert page == draw_architecture.page_with(page, draw_architecture.room_imports()), (
        'run `python -m redundant_planner.tools.draw_architecture`')
    assert draw_architecture.table(draw_architecture.room_imports()) in page


def test_imports_are_read_from_the_files(tmp_path):
    (tmp_path / 'core' / 'robot').mkdir(parents=True)
    (tmp_path / 'io').mkdir()
    (tmp_path / 'io' / 'bags.py').write_text(
        'import numpy\nimport redundant_planner.core.planner\n'
        'def late():\n    from redundant_planner.core.robot.model import Robot\n')
    (tmp_path / 'core' / 'robot' / 'model.py').write_text(
        'from redundant_planner.core.errors import RobotError\n')
    imports = draw_architecture.room_imports(tmp_path)
    assert imports['io'] == ('core', 'core/robot')
    assert imports['core/robot'] == imports['nodes'] == ()


def test_an_import_that_follows_from_others_is_not_drawn():
    imports = {'tools': ('analysis', 'io'), 'analysis': ('io',), 'io': ('core/robot', 'tools'),
               'core': ('core/horizon', 'core/robot'), 'core/horizon': ('core/robot',)}
    assert draw_architecture.drawn_arrows(imports) == [
        ('analysis', 'io'), ('core', 'core/horizon'), ('core/horizon', 'core/robot'),
        ('io', 'core'), ('io', 'tools'), ('tools', 'analysis')]


@pytest.mark.long
def test_the_command_writes_the_same_picture_every_time(tmp_path, monkeypatch):
    (tmp_path / 'architecture.md').write_text((DOCS / 'architecture.md').read_text())
    monkeypatch.setattr(sys, 'argv', ['draw_architecture', '--docs', str(tmp_path)])
    pictures = []
    for _ in range(2):
        draw_architecture.main()
        pictures.append((tmp_path / 'architecture.svg').read_bytes())
    assert pictures[0] == pictures[1]

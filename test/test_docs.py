"""What the docs say is what the code says."""

from __future__ import annotations

from pathlib import Path
import re

import pytest

from redundant_planner.nodes.ros_parameters import parameter_page

TOP = Path(__file__).resolve().parent.parent
PAGES = [TOP / 'README.md', TOP / 'CONTRIBUTING.md', *sorted((TOP / 'docs').glob('*.md'))]
# Made by commands, lines as long as they come.
MADE = ('parameters.md',)
WIDEST = 100


def prose(page: Path) -> list[str]:
    """Return the lines that are neither code, nor tables, nor headings, nor pictures."""
    without_code = re.sub(r'^```.*?^```', '', page.read_text(), flags=re.S | re.M)
    return [line for line in without_code.splitlines()
            if not line.startswith(('|', '    ', '#', '!', '<!--'))]


def test_the_parameter_page_is_up_to_date():
    assert (TOP / 'docs' / 'parameters.md').read_text() == parameter_page()


@pytest.mark.parametrize('page', PAGES, ids=lambda p: p.name)
def test_files_named_in_the_docs_exist(page):
    text = page.read_text()
    for link in re.findall(r'\]\((?!http)([^)#]+)', text):
        assert (page.parent / link).exists(), f'{page.name} links to {link}'
    inside = {path.relative_to(TOP / 'redundant_planner').as_posix()
              for path in (TOP / 'redundant_planner').rglob('*.py')}
    tests = {path.name for path in (TOP / 'test').rglob('*.py')}
    for name in re.findall(r'(?<![\w/.-])(?:redundant_planner/)?([\w/]+\.py)\b', text):
        known = (name in inside or (TOP / name).is_file() or name in tests)
        assert known, f'{page.name} names {name}'
    for name in re.findall(r'`((?:config|docs|launch|test|benchmark)/[\w/.]+\.\w+)`', text):
        assert (TOP / name).is_file(), f'{page.name} names {name}'


@pytest.mark.parametrize('page', PAGES, ids=lambda p: p.name)
def test_commands_named_in_the_docs_exist(page):
    for name in re.findall(r'python -m ((?:benchmark|redundant_planner)[\w.]*)', page.read_text()):
        path = TOP / name.replace('.', '/')
        assert path.with_suffix('.py').is_file() or (path / '__main__.py').is_file(), (
            f'{page.name} runs {name}')


@pytest.mark.parametrize('page', [p for p in PAGES if p.name not in MADE], ids=lambda p: p.name)
def test_prose_is_at_most_100_columns_wide(page):
    for line in prose(page):
        assert len(line) <= WIDEST, f'{page.name}: {line}'


@pytest.mark.parametrize('page', PAGES, ids=lambda p: p.name)
def test_the_docs_refer_to_nothing_that_users_do_not_have(page):
    assert 'DESIGN' not in page.read_text() and 'REVIEW' not in page.read_text()


def test_the_ten_lines_are_those_of_the_first_example():
    shown = re.search(r'```python\n(.*?)```', (TOP / 'README.md').read_text(), flags=re.S)
    assert shown is not None
    example = (TOP / 'examples' / '01_follow_a_twist.py').read_text()
    assert example.endswith(shown.group(1))


def test_each_picture_of_the_gallery_stands_above_the_command_that_makes_it():
    text = (TOP / 'docs' / 'gallery.md').read_text()
    parts = re.split(r'^!\[[^]]+\]\(([^)]+)\)$', text, flags=re.M)[1:]
    pictures, below = parts[::2], parts[1::2]
    assert len(pictures) > 10
    for picture in pictures:
        assert (TOP / 'docs' / picture).stat().st_size < 800_000, picture
    # Pictures of one command stand together.
    assert [p for p, words in zip(pictures, below) if not re.search(r'^    \S', words, re.M)] == [
        'figures/horizon_paper.png']
    entry_points = (TOP / 'setup.py').read_text() + (TOP / 'setup.cfg').read_text()
    for command in re.findall(r'^    (\w+) ', text, flags=re.M):
        known = command in ('python', 'cp') or f'{command} =' in entry_points or (
            TOP / 'redundant_planner' / 'tools' / f'{command}.py').is_file()
        assert known or command == 'PYTHONPATH', command

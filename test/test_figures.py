"""docs/figures.md is what the kept figures say, in the shape that it promises."""

from __future__ import annotations

import json
import re
import subprocess

import pytest

from benchmark import figures
from benchmark.figure_questions import Figure, LESS, MORE, QUESTIONS
from benchmark.figures import (
    FiguresError,
    FOLDER,
    main,
    number,
    PAGE,
    page_of,
    peers_are_better,
    RUN,
    said,
    table_of,
    TOP,
)
from benchmark.peers import PEERS

# A table that shows figures of that run, and of which questions.
MARK = re.compile(r'<!-- figures: ([a-z_ ]+) -->\n\n((?:\|.*\n)+)')
PAGES = [TOP / 'README.md', *sorted((TOP / 'docs').glob('*.md'))]
ABOUT = json.loads((FOLDER / RUN).read_text())
TEXT = PAGE.read_text()


def test_the_page_is_that_of_the_kept_figures():
    assert page_of(FOLDER) == TEXT


def test_every_question_has_a_table_its_command_and_a_file():
    assert {file.stem for file in FOLDER.glob('*.json')} == {
        *(question.name for question in QUESTIONS), 'run'}
    assert not ABOUT['failed']
    sections = TEXT.split('\n## ')[1:]
    assert len(sections) == len(QUESTIONS)
    for question, section in zip(QUESTIONS, sections):
        title, _, rest = section.partition('\n')
        assert title == question.title
        assert f'\n    {ABOUT["commands"][question.name]}\n' in rest
        assert re.search(r'^\| [^|]+ \|.* [\d.*e-]+ \|', rest, flags=re.M), title


def test_the_commands_are_those_of_the_questions():
    """Somebody who types them gets these figures, not those of an earlier list."""
    taken = [name for name in PEERS if f' {name} ' in ''.join(
        f'{command} ' for command in ABOUT['commands'].values())]
    for question in QUESTIONS:
        assert ABOUT['commands'][question.name] == said(
            question.command(taken, quick=ABOUT['quick']))


def test_it_says_machine_date_versions_and_how_much_was_run():
    head = ' '.join(TEXT.split('\n## ')[0].split())
    assert ABOUT['machine'] in head and ABOUT['date'] in head
    for name in ('redundant_planner', 'numpy', 'pin', 'daqp'):
        assert f'{name} {ABOUT["versions"][name]}' in head
    assert ('too few to compare by' in head) == ABOUT['quick']


def test_what_peers_do_better_stands_first_and_the_best_is_bold():
    rows = [
        Figure('ours', LESS, {'dynamic_factor': 1.0, 'mink': 2.0}),
        Figure('alike', LESS, {'dynamic_factor': 0.0, 'mink': 0.0}),
        Figure('theirs', MORE, {'dynamic_factor': 50.0, 'mink': 70.0}),
        Figure('nobody better', '', {'dynamic_factor': 3.0, 'mink': 2.0}),
        Figure('not known', LESS, {'dynamic_factor': float('nan'), 'mink': 2.0})]
    assert [peers_are_better(row) for row in rows] == [False, False, True, False, False]
    lines = table_of(rows).splitlines()
    assert lines[0] == '| | `dynamic_factor` | mink |'
    assert lines[2] == '| theirs | 50 | **70** |'
    assert lines[3:6] == ['| ours | **1** | 2 |', '| alike | 0 | 0 |', '| nobody better | 3 | 2 |']
    assert lines[6] == '| not known |  | 2 |'


def numbers(text: str) -> set[str]:
    return set(re.findall(r'-?\d+(?:\.\d+)?(?:e-\d+)?', text))


def not_in_the_run(page: str) -> set[str]:
    """Return the numbers of a page's marked tables that their questions' tables do not have."""
    tables = dict(zip((question.name for question in QUESTIONS), TEXT.split('\n## ')[1:]))
    unknown = set()
    for names, table in MARK.findall(page):
        sections = '\n'.join(tables[name] for name in names.split())
        there = numbers('\n'.join(re.findall(r'^\|.*', sections, flags=re.M)))
        for row in table.splitlines()[2:]:
            unknown |= numbers('|'.join(row.split('|')[2:])) - there
    return unknown


def test_tables_of_other_pages_have_the_figures_of_this_run():
    texts = {page.name: page.read_text() for page in PAGES}
    assert {name for name, text in texts.items() if MARK.search(text)} >= {
        'README.md', 'from_mink.md'}
    for name, text in texts.items():
        assert text.count('<!-- figures') == len(MARK.findall(text)), name
        assert not not_in_the_run(text), name


def test_a_figure_of_another_run_is_noticed():
    text = '<!-- figures: moving -->\n\n| | a |\n|---|---|\n| of 77 scenes | 123.4567 |\n'
    assert not_in_the_run(text) == {'123.4567'}


@pytest.mark.parametrize(('value', 'text'), [
    (0.0, '0'), (2e-13, '0'), (42.0, '42'), (0.12345, '0.123'), (12345.6, '12346'),
    (3.2e-4, '3e-04'), (-59.12, '-59.1')])
def test_numbers_have_three_digits(value, text):
    assert number(value) == text


def test_a_folder_without_figures_is_refused_by_its_file(tmp_path, capsys):
    with pytest.raises(FiguresError, match=re.escape(str(tmp_path / RUN))):
        page_of(tmp_path)
    (tmp_path / RUN).write_text((FOLDER / RUN).read_text())
    (tmp_path / 'scenarios.json').write_text('{"dynamic_factor": {"collisions": 0}}')
    with pytest.raises(FiguresError, match=r'scenarios\.json.* is not what'):
        page_of(tmp_path)
    assert main(['--read', str(tmp_path), '--out', str(tmp_path / 'page.md')]) == 2
    assert 'scenarios.json' in capsys.readouterr().err


def test_a_run_leaves_what_it_found_and_says_what_failed(tmp_path, monkeypatch):
    ran = []

    def instead(command, **_):
        ran.append(command)
        file, module = command[-1], command[2]
        if module == 'benchmark.two_arms':
            return subprocess.CompletedProcess(command, 1, '', 'Traceback\nno Panda URDF')
        if module == 'benchmark.chunks':
            raise subprocess.TimeoutExpired(command, 300.0)
        with open(file, 'w') as out:
            out.write((FOLDER / file.rpartition('/')[2]).read_text())
        return subprocess.CompletedProcess(command, 0, '', '')

    monkeypatch.setattr(figures.subprocess, 'run', instead)
    assert main(['--run', str(tmp_path), '--quick', '--read', str(tmp_path),
                 '--out', str(tmp_path / 'page.md')]) == 1
    assert [command[2] for command in ran] == [question.module for question in QUESTIONS]
    about = json.loads((tmp_path / RUN).read_text())
    assert about['failed'] == {'two_arms': 'no Panda URDF', 'chunks': 'not done after 300 s'}
    page = (tmp_path / 'page.md').read_text()
    assert 'It failed: no Panda URDF.' in page and 'quick run' in page
    assert not (tmp_path / 'chunks.json').exists()


def test_a_question_is_added_to_a_run_of_the_same_machine_and_versions(tmp_path, monkeypatch):
    def instead(command, **_):
        file = command[-1]
        with open(file, 'w') as out:
            out.write((FOLDER / file.rpartition('/')[2]).read_text())
        return subprocess.CompletedProcess(command, 0, '', '')

    def answered(*options):
        assert main(['--run', str(tmp_path), *options]) == 0
        return set(json.loads((tmp_path / RUN).read_text())['commands'])

    monkeypatch.setattr(figures.subprocess, 'run', instead)
    assert answered('--only', 'moving') == {'moving'}
    assert answered('--only', 'targets') == {'moving', 'targets'}
    assert answered('--only', 'moving') == {'moving', 'targets'}
    assert answered('--only', 'speed', '--quick') == {'speed'}  # another kind of run
    monkeypatch.setattr(figures, '__version__', '9.9.9')
    assert answered('--only', 'chunks', '--quick') == {'chunks'}


def test_without_a_panda_nothing_is_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(figures, 'panda_urdf', lambda: None)
    monkeypatch.setattr(figures.subprocess, 'run', None)
    assert main(['--run', str(tmp_path / 'out')]) == 2
    assert 'no Panda URDF' in capsys.readouterr().err and not (tmp_path / 'out').exists()

"""The package as an index or rosdep sees it: what the sdist holds, and what it says of itself."""

from __future__ import annotations

from email import message_from_string
from email.message import Message
from importlib.metadata import version
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tarfile
from xml.etree import ElementTree

from docutils.core import publish_doctree
from docutils.nodes import section, title
from markdown_it import MarkdownIt
import pytest

import redundant_planner
from redundant_planner.core.machine_code import choice

TOP = Path(__file__).resolve().parent.parent
VERSION = redundant_planner.__version__
IGNORED = shutil.ignore_patterns('.*', '__pycache__', '*.egg-info', 'build', 'install', 'log',
                                 'demo_output', 'test', 'benchmark')
CHANGELOG = (TOP / 'CHANGELOG.rst').read_text(encoding='utf-8')


@pytest.fixture(scope='module')
def sdist(tmp_path_factory) -> dict[str, bytes]:
    """Return the files of an sdist: path inside it → content."""
    folder = tmp_path_factory.mktemp('sdist')
    shutil.copytree(TOP, folder / 'source', ignore=IGNORED)
    done = subprocess.run(
        [sys.executable, 'setup.py', '--quiet', 'sdist', '--dist-dir', str(folder)],
        cwd=folder / 'source', capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    with tarfile.open(next(folder.glob('*.tar.gz'))) as archive:
        return {member.name.partition('/')[2]: archive.extractfile(member).read()
                for member in archive if member.isfile()}


@pytest.fixture(scope='module')
def metadata(sdist) -> Message:
    return message_from_string(sdist['PKG-INFO'].decode())


@pytest.fixture(scope='module')
def manifest() -> ElementTree.Element:
    return ElementTree.parse(TOP / 'package.xml').getroot()


def test_the_sdist_has_all_that_an_installation_takes(sdist):
    wanted = {path.relative_to(TOP).as_posix() for folder in ('config', 'launch', 'resource')
              for path in (TOP / folder).rglob('*')
              if path.is_file() and '__pycache__' not in path.parts}
    wanted |= {'package.xml', 'LICENSE', 'README.md', 'CHANGELOG.rst', 'setup.cfg',
               'redundant_planner/py.typed', 'redundant_planner/playground/page.js'}
    assert wanted <= set(sdist), wanted - set(sdist)


def test_versions_agree(metadata, manifest):
    assert metadata['Version'] == manifest.findtext('version') == VERSION
    newest = next(node for node in publish_doctree(CHANGELOG).findall(section))
    assert newest.next_node(title).astext().startswith(f'{VERSION} (')
    major, minor, _ = VERSION.split('.')
    notes = TOP / 'docs' / f'release_notes_{major}_{minor}.md'
    assert notes.read_text(encoding='utf-8').startswith(f'# Version {VERSION}\n')


def test_licence_home_and_maintainer_agree(metadata, manifest):
    assert metadata['License'] == manifest.findtext('license') == 'Apache-2.0'
    assert metadata['Home-page'] == manifest.findtext('url')
    maintainer = manifest.find('maintainer')
    assert metadata['Maintainer'] == maintainer.text
    assert metadata['Maintainer-email'] == maintainer.get('email')


def test_every_python_version_that_is_named_is_tried_by_ci(metadata):
    named = {line.rpartition(' ')[2] for line in metadata.get_all('Classifier')
             if re.search(r':: 3\.\d+$', line)}
    workflow = (TOP / '.github' / 'workflows' / 'ci.yml').read_text(encoding='utf-8')
    tried = re.search(r'^ +python: \[(.*)\]$', workflow, flags=re.M)
    assert tried is not None
    assert named == set(re.findall(r'[\d.]+', tried.group(1)))
    assert metadata['Requires-Python'] == f'>={min(named)}'


def test_the_readme_renders_without_the_repository(metadata):
    """Headings, tables and pictures come out, and no link is relative."""
    assert metadata['Description-Content-Type'] == 'text/markdown'
    tokens = MarkdownIt('commonmark').enable('table').parse(metadata.get_payload())
    inner = [child for token in tokens for child in token.children or ()]
    links = [str(token.attrs[key]) for token in inner for key in ('href', 'src')
             if key in token.attrs]
    assert len(links) > 10
    for link in links:
        assert link.startswith(('https://', 'http://', '#')), link
    tables = re.findall(r'^\|[-|]+\|$', metadata.get_payload(), flags=re.M)
    assert sum(token.type == 'table_open' for token in tokens) == len(tables) >= 3
    text = ' '.join(token.content for token in inner if token.type == 'text')
    assert not re.search(r'\]\(|^\||```', text), 'Markdown that was not understood'


def test_the_changelog_is_valid_rst():
    assert not list(publish_doctree(CHANGELOG).findall(
        lambda node: node.tagname == 'system_message'))


def test_one_range_of_numba_is_named_everywhere_and_tried_by_ci(sdist, manifest):
    lowest, highest = (f'{major}.{minor}' for major, minor in (choice.LOWEST, choice.HIGHEST))
    beyond = f'{choice.HIGHEST[0]}.{choice.HIGHEST[1] + 1}'
    wanted = f'numba>={lowest},<{beyond}'
    (entry,) = (e for e in manifest.findall('exec_depend') if e.text == 'python3-numba')
    assert entry.attrib == {'version_gte': lowest, 'version_lt': beyond}
    for file in ('README.md', 'Dockerfile'):
        assert f"'{wanted}'" in (TOP / file).read_text(encoding='utf-8'), file
    required = re.search(r'^numba(.*)$', sdist['redundant_planner.egg-info/requires.txt'].decode(),
                         flags=re.M)
    assert set(required.group(1).split(',')) == {f'>={lowest}', f'<{beyond}'}
    tried = (TOP / '.ci' / 'lowest.txt').read_text(encoding='utf-8')
    assert re.search(rf'^numba=={re.escape(lowest)}\.\d+;', tried, flags=re.M)
    # CI's other environments have the newest that pip finds in the range.
    assert version('numba').startswith((f'{lowest}.', f'{highest}.'))


def test_rosdep_skips_what_the_virtual_environment_brings(manifest):
    """The README's and the Dockerfile's lines agree with package.xml, and what it names exists."""
    keys = {entry.text for entry in manifest.findall('exec_depend')}
    for file in ('README.md', 'Dockerfile'):
        skipped = re.search(r'--skip-keys\s+"([^"]+)"', (TOP / file).read_text(encoding='utf-8'))
        assert skipped is not None, file
        assert set(skipped.group(1).split()) <= keys, file
    pip_keys = {key for key in keys if key.endswith('-pip')}
    assert pip_keys <= set(skipped.group(1).split())

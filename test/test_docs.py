"""What the docs say is what the code says."""

from __future__ import annotations

from pathlib import Path
import re

import pytest

from redundant_planner.nodes.ros_parameters import parameter_page

TOP = Path(__file__).resolve().parent.parent
PAGES = [TOP / 'README.md', TOP / 'CONTRIBUTING.md', *sorted((TOP / 'docs').glob('*.md'))]


def test_the_parameter_page_is_up_to_date():
    assert (TOP / 'docs' / 'parameters.md').read_text() == parameter_page()


@pytest.mark.parametrize('page', PAGES, ids=lambda p: p.name)
def test_files_named_in_the_docs_exist(page):
    text = page.read_text()
    for link in re.findall(r'\]\((?!http)([^)#]+)', text):
        assert (page.parent / link).exists(), f'{page.name} links to {link}'
    for name in re.findall(r'`((?:core|nodes|analysis)/\w+\.py)`', text):
        assert (TOP / 'redundant_planner' / name).is_file(), f'{page.name} names {name}'
    for name in re.findall(r'`((?:config|docs|launch|test|benchmark)/[\w/.]+\.\w+)`', text):
        assert (TOP / name).is_file(), f'{page.name} names {name}'


def test_versions_agree():
    import redundant_planner
    version = redundant_planner.__version__
    assert f"version='{version}'" in (TOP / 'setup.py').read_text()
    assert f'<version>{version}</version>' in (TOP / 'package.xml').read_text()
    assert version in (TOP / 'CHANGELOG.rst').read_text()

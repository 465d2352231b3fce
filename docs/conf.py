"""How Sphinx builds these pages and the API reference: `make docs`."""

import os
from pathlib import Path
import sys

# The reference needs the docstrings alone, so nothing has to be compiled.
os.environ.setdefault('NUMBA_DISABLE_JIT', '1')
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import redundant_planner

project = 'redundant_planner'
author = 'redundant_planner developers'
copyright = f'{author}, Apache-2.0'
version = release = redundant_planner.__version__

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
html_theme = 'furo'
html_title = f'{project} {release}'

# Links such as safety.md#proof lead to headings.
myst_heading_anchors = 4

autoclass_content = 'both'
autodoc_member_order = 'bysource'
autodoc_typehints = 'description'
autodoc_typehints_description_target = 'documented'
# Written as in the code; the docstrings give the shapes.
autodoc_type_aliases = {'Array': 'Array', 'npt.ArrayLike': 'ArrayLike'}
napoleon_use_ivar = True

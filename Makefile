# Two commands do everything: `make demo` and `make test`. Both set up $(VENV) first. `make play`
# opens the playground.
# `make docs` builds the pages and the API reference into build/docs/index.html.
PYTHON ?= python3
VENV ?= .venv
PIP_INSTALL = $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check
# So that no node has to, the first time it starts.
COMPILE = $(VENV)/bin/python -m redundant_planner.compile

.PHONY: demo play test lint docs clean

demo: $(VENV)/.demo-ready
	$(VENV)/bin/demo --out demo_output

play: $(VENV)/.play-ready
	$(VENV)/bin/playground

test: $(VENV)/.test-ready lint
	$(VENV)/bin/python test/side_by_side.py

lint: $(VENV)/.test-ready
	$(VENV)/bin/ruff check .
	$(VENV)/bin/mypy

docs: $(VENV)/.docs-ready
	$(VENV)/bin/python -m sphinx -W --keep-going -b html docs build/docs

# The pip that Python 3.10 brings finds no set of versions that fit together: hence the newest.
$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; assert (3, 10) <= sys.version_info < (3, 14), \
	    f"Python 3.10 to 3.13 is needed, this is {sys.version.split()[0]}; try make PYTHON=python3.12"'
	$(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) --upgrade pip

$(VENV)/.demo-ready: setup.py setup.cfg | $(VENV)/bin/python
	$(PIP_INSTALL) --editable '.[jazzy,analysis]'
	$(COMPILE)
	touch $@

$(VENV)/.play-ready: setup.py setup.cfg | $(VENV)/bin/python
	$(PIP_INSTALL) --editable '.[jazzy,viewer]'
	$(COMPILE)
	touch $@

$(VENV)/.test-ready: setup.py setup.cfg | $(VENV)/bin/python
	$(PIP_INSTALL) --editable '.[jazzy,analysis,test]'
	$(COMPILE)
	touch $@ $(VENV)/.demo-ready $(VENV)/.play-ready

$(VENV)/.docs-ready: setup.py setup.cfg | $(VENV)/bin/python
	$(PIP_INSTALL) --editable '.[docs]'
	touch $@

clean:
	rm -rf $(VENV) demo_output build install log *.egg-info

# Two commands do everything: `make demo` and `make test`. Both set up $(VENV) first. `make play`
# opens the playground.
# `make docs` builds the pages and the API reference into build/docs/index.html.
PYTHON ?= python3
VENV ?= .venv
PIP_INSTALL = $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check
# So that no node has to, the first time it starts, also after a pull.
COMPILE = $(VENV)/bin/python -m redundant_planner.compile
# Python with machine code that checks every index; it lies beside the other.
CHECKED = NUMBA_BOUNDSCHECK=1 $(VENV)/bin/python
BOUNDS = $(addprefix bounds-,target safety core fuzz paper worst)
LOWEST = $(VENV)-lowest

.PHONY: demo play test test-long lint bounds lowest docs clean

demo: $(VENV)/.demo-ready
	$(COMPILE)
	$(VENV)/bin/demo --out demo_output

play: $(VENV)/.play-ready
	$(COMPILE)
	$(VENV)/bin/playground

test: $(VENV)/.test-ready lint
	$(VENV)/bin/python test/side_by_side.py

# Every night: all tests, and those with random input in full.
test-long: $(VENV)/.test-ready lint
	$(VENV)/bin/python test/side_by_side.py --long

lint: $(VENV)/.test-ready
	$(VENV)/bin/ruff check .
	$(VENV)/bin/mypy

# Does compiled code stay within its arrays? Two jobs at a time, the longest first.
bounds: $(VENV)/.test-ready
	$(CHECKED) -m redundant_planner.compile
	$(MAKE) --no-print-directory --jobs 2 --output-sync=target $(BOUNDS)

.PHONY: $(BOUNDS)
bounds-target:
	$(CHECKED) -m pytest -q --long test/core/target
bounds-safety:
	$(CHECKED) -m pytest -q --long test/core/robot test/core/safety
# Those of test_kernels.py are about how machine code is kept, and of test_imports.py about files.
bounds-core:
	$(CHECKED) -m pytest -q --long test/core --ignore test/core/target --ignore test/core/robot \
	    --ignore test/core/safety --ignore test/core/test_kernels.py \
	    --ignore test/core/test_numba.py --ignore test/core/test_imports.py
bounds-fuzz:
	for kind in core clouds bytes; do \
	    $(CHECKED) -m benchmark.fuzz --seed 1 --minutes 0.4 --what $$kind || exit 1; done
bounds-paper:
	$(CHECKED) -m pytest -q --long test/paper test/perception
bounds-worst:
	$(CHECKED) -m benchmark.worst_case --ticks 10000

# The lowest Numba that setup.py takes, on the NumPy and SciPy of Ubuntu 24.04.
lowest: $(LOWEST)/.ready
	cd test/core && export NUMBA_CACHE_DIR=$(abspath $(LOWEST))/cache PYTHONPATH=$(CURDIR) && \
	    $(abspath $(LOWEST))/bin/python -m redundant_planner.compile && \
	    $(abspath $(LOWEST))/bin/python -m pytest -q --long test_numba.py test_planner.py \
	        test_kernels.py -k 'not plainly and not kept and not anew and not two_processes'

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

# pin asks for a newer NumPy than Ubuntu's, and does without.
$(LOWEST)/.ready: .ci/lowest.txt
	$(PYTHON) -m venv $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check --upgrade pip
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check \
	    'pin>=3' 'daqp>=0.5' 'PyYAML>=6' setuptools \
	    example-robot-data hypothesis pytest pytest-rerunfailures
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps \
	    --requirement .ci/lowest.txt
	touch $@

$(VENV)/.docs-ready: setup.py setup.cfg | $(VENV)/bin/python
	$(PIP_INSTALL) --editable '.[docs]'
	touch $@

clean:
	rm -rf $(VENV) $(LOWEST) demo_output build install log *.egg-info

# The environment is made once, and again when pyproject.toml or constraints.txt change.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
PYTEST := $(BIN)/python -m pytest --durations 10
DURATIONS := build/durations

# Parts of the tests by their markers: pyproject.toml, docs/testing.md.
COMPUTING := not real_time and not large
SHORT := not long and $(COMPUTING)
WAITING := real_time and not whole_fleet and not large
FLEETS := whole_fleet and not large

unexport PYTHONDONTWRITEBYTECODE  # processes start faster from compiled modules

.PHONY: demo lint quick test test-all durations bench docs package clean

demo: $(READY)  ## four daemons fly the position swap over Zenoh, in virtual time
	$(BIN)/agentd launch position_swap --clock virtual

lint: $(READY)  ## format, style and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

quick: lint  ## lint, and the tests that take less than 0.4 s and no real time: what to run after every change
	$(PYTEST) --numprocesses 2 --dist worksteal --junitxml $(DURATIONS)/1-short.xml -m '$(SHORT)'

test: lint  ## every check but the large ones; fails below the branch coverage reached (pyproject.toml)
	$(PYTEST) --numprocesses 2 --dist worksteal --cov -m '$(SHORT)'
	$(PYTEST) --numprocesses 2 --dist worksteal --junitxml $(DURATIONS)/2-long.xml -m 'long and $(COMPUTING)'
	$(PYTEST) --numprocesses 6 --dist worksteal --junitxml $(DURATIONS)/3-real-time.xml -m '$(WAITING)'
	$(PYTEST) --numprocesses 2 --dist loadfile --junitxml $(DURATIONS)/4-whole-fleets.xml -m '$(FLEETS)'

test-all: test  ## every check
	$(PYTEST) --numprocesses 2 --dist worksteal -m 'large and not real_time'
	$(PYTEST) -m 'large and real_time'

durations: $(READY)  ## write down how long the tests of the last make quick and make test took
	$(BIN)/python -m tests.support.durations $(DURATIONS)/*.xml

bench: $(READY)  ## ratios against a bare Zenoh loop and the bare generators
	$(BIN)/python benchmarks/rounds.py
	$(BIN)/python benchmarks/simulate.py
	$(BIN)/python benchmarks/faults.py
	$(BIN)/python benchmarks/latency.py
	$(BIN)/python benchmarks/crazyflie.py
	$(BIN)/python benchmarks/wall_clock.py
	$(BIN)/python benchmarks/emergency_stop.py
	$(BIN)/python benchmarks/start.py

docs: $(READY)  ## the web site of the documents, in build/site; warnings are errors
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

package: $(READY)  ## source distribution and wheel in dist/, checked
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[package]'
	rm -rf build dist
	$(BIN)/python -m build
	$(BIN)/python -m twine check --strict dist/*

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis build dist *.egg-info

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("dcf-zenoh needs Python 3.11 or newer: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $@

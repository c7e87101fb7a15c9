# The environment is made once, and again when pyproject.toml or constraints.txt change.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

unexport PYTHONDONTWRITEBYTECODE  # processes start faster from compiled modules

.PHONY: demo test bench docs package clean

demo: $(READY)  ## four daemons fly the position swap over Zenoh, in virtual time
	$(BIN)/agentd launch position_swap --clock virtual

test: $(READY)  ## every check
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal --durations 10 -m 'not real_time'
	$(BIN)/python -m pytest --numprocesses 4 --dist worksteal --durations 10 -m 'real_time and not alone'
	$(BIN)/python -m pytest --durations 20 -m alone

bench: $(READY)  ## ratios against a bare Zenoh loop and the bare generators
	$(BIN)/python benchmarks/rounds.py
	$(BIN)/python benchmarks/simulate.py
	$(BIN)/python benchmarks/faults.py
	$(BIN)/python benchmarks/latency.py
	$(BIN)/python benchmarks/crazyflie.py
	$(BIN)/python benchmarks/wall_clock.py

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

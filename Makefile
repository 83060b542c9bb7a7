# Every target sets up .venv itself from a bare python3 (3.11 or later) with pip.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --disable-pip-version-check --quiet
PLUGINS := $(wildcard plugins/*/pyproject.toml)
# A folder of further field logs, where there is one.
LOGS ?= $(wildcard ../shared/data)

.PHONY: demo test test-all test-wheels lint bench schema reproduce agreement fuzz

demo: .venv/runtime  ## convert a real drive, attack it, run the detectors, print the leaderboards
	$(BIN)/spoofbench demo -o demo

# One thread each: threads only slow small matrices down.
test test-all test-wheels: export OPENBLAS_NUM_THREADS ?= 1

test: .venv/development  ## the quick suite: all but the tests marked slow, one process per core
	$(BIN)/python -m pytest -n auto -m "not slow"

test-all: .venv/development  ## every test
	$(BIN)/python -m pytest -n auto

test-wheels: .venv/development  ## every test on the built wheels, in an environment that has no source tree
	rm -rf dist .venv-wheels
	for folder in . $(dir $(PLUGINS)); do $(BIN)/python -m build --wheel --outdir dist $$folder || exit 1; done
	$(PYTHON) -m venv .venv-wheels
	.venv-wheels/bin/python -m pip install --disable-pip-version-check --quiet -c constraints.txt dist/*.whl "spoofbench[demo,dev]"
	.venv-wheels/bin/python -m pytest -n auto

lint: .venv/development
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: .venv/bench  ## speed against other libraries, side by side
	$(BIN)/python -m benchmarks.speed

reproduce: .venv/runtime  ## the papers' tables and figures beside ours, in benchmarks/reproductions
	$(BIN)/spoofbench reproduce tanil2018 kujur lo2017 borio -o benchmarks/reproductions $(if $(LOGS),--data $(LOGS))

agreement: .venv/bench  ## our converters against other parsers, on the logs in ../shared/data
	$(BIN)/python -m benchmarks.agreement

fuzz: .venv/runtime  ## mutated logs against every converter and the reader of recordings
	$(BIN)/python -m benchmarks.fuzz

schema: .venv/development  ## regenerate the protobuf modules
	$(BIN)/python schemas/generate.py

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "spoofbench needs Python 3.11 or later: make PYTHON=python3.11 $(MAKECMDGOALS)" >&2; exit 1; }
	$(PYTHON) -m venv .venv

.venv/runtime: requirements.txt constraints.txt pyproject.toml $(PLUGINS) | .venv/bin/python
	@echo "installing spoofbench, its plugins, the drive and the flights into .venv (once, about a minute)"
	$(PIP) -r requirements.txt
	$(PIP) --no-deps -c constraints.txt traffic  # for its samples alone
	@touch $@

.venv/development: requirements-dev.txt .venv/runtime
	$(PIP) -r requirements-dev.txt
	@touch $@

.venv/bench: .venv/runtime
	$(PIP) -c constraints.txt -e '.[bench]'
	@touch $@

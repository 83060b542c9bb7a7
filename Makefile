# Every target sets up .venv itself from a bare python3 (3.11 or later) with pip.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --disable-pip-version-check --quiet
PLUGINS := $(wildcard plugins/*/pyproject.toml)

.PHONY: demo test lint bench schema

demo: .venv/runtime  ## convert a real drive, attack it, run the detectors, print the leaderboard
	$(BIN)/spoofbench demo -o demo

test: .venv/development
	$(BIN)/python -m pytest

lint: .venv/development
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: .venv/bench  ## speed against other libraries, side by side
	$(BIN)/python -m benchmarks.speed

schema: .venv/development  ## regenerate the protobuf modules
	$(BIN)/python schemas/generate.py

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "spoofbench needs Python 3.11 or later: make PYTHON=python3.11 $(MAKECMDGOALS)" >&2; exit 1; }
	$(PYTHON) -m venv .venv

.venv/runtime: requirements.txt constraints.txt pyproject.toml $(PLUGINS) | .venv/bin/python
	@echo "installing spoofbench, its plugins and the drive into .venv (once, about a minute)"
	$(PIP) -r requirements.txt
	@touch $@

.venv/development: requirements-dev.txt .venv/runtime
	$(PIP) -r requirements-dev.txt
	@touch $@

.venv/bench: .venv/runtime
	$(PIP) -c constraints.txt -e '.[bench]'
	@touch $@

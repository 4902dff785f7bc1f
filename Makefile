# Each target does its own set-up: a private venv with pinned dependencies. Needs Python 3.11 and make.
PYTHON ?= python3.11
ifeq ($(shell command -v $(PYTHON) 2>/dev/null),)
PYTHON = python3
endif
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
# Phases and processes import the same modules: they are compiled once, whatever the environment says.
unexport PYTHONDONTWRITEBYTECODE

WIRE := -m "wire and not alone and not soak"
ALONE := -m "alone and not soak"

.PHONY: demo test lint soak bench docs clean

demo: $(VENV)/.ready
	$(BIN)/cellward demo

# Tests of whole cells and those that stream or count milliseconds need the machine for themselves; others on the
# wire mostly wait. A virtual machine whose host takes its cores for a tenth of a second fails any of them: what
# failed is tried once more.
test: $(VENV)/.ready lint
	$(BIN)/pytest -m "not wire and not soak" --numprocesses 2 --dist worksteal
	$(BIN)/pytest $(WIRE) --numprocesses 2 --dist loadfile || $(BIN)/pytest $(WIRE) --last-failed
	$(BIN)/pytest $(ALONE) || $(BIN)/pytest $(ALONE) --last-failed

lint: $(VENV)/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

soak: $(VENV)/.ready
	$(BIN)/pytest tests/soak -m soak

bench: $(VENV)/.ready
	$(BIN)/python -m bench

docs: $(VENV)/.ready
	$(BIN)/python -m daemon.docs

$(VENV)/.ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP) setuptools wheel
	$(PIP) --no-build-isolation --editable '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) demo-out build *.egg-info

# Each target does its own set-up: a private venv with pinned dependencies. Needs make and Python 3.11 or 3.12.
VENV := .venv
# The Python that is named, else that of the venv, else the first of these that is supported.
PYTHON ?= $(or $(wildcard $(VENV)/bin/python),$(shell for p in python3.11 python3.12 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12)))' 2>/dev/null && echo $$p && break; done),python3)

define CHECK_PYTHON
import sys
version = "{}.{}".format(*sys.version_info[:2])
if sys.version_info[:2] < (3, 11):
    sys.exit("Cellward runs on Python 3.11 and 3.12, not on " + version + ", which lacks what it uses of the standard library: install one of them, or name it: make PYTHON=/path/to/python3.12")
if sys.version_info[:2] > (3, 12):
    sys.exit("Cellward runs on Python 3.11 and 3.12, not on " + version + ", for which ur-rtde has no wheel: install one of them, or name it: make PYTHON=/path/to/python3.12")
import importlib.util, os
missing = [m for m in ("venv", "ensurepip") if importlib.util.find_spec(m) is None]
if missing and not os.path.exists("$(VENV)/bin/python"):
    sys.exit("Python " + version + " has no module " + missing[0] + ", which make needs for its venv: install it (on Debian and Ubuntu: apt-get install python" + version + "-venv)")
endef
export CHECK_PYTHON

VERSION_OF := -c 'import sys; print("%d.%d" % sys.version_info[:2])'
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
# Phases and processes import the same modules: they are compiled once, whatever the environment says.
unexport PYTHONDONTWRITEBYTECODE

VIRTUAL := -m "not wire and not soak"
WIRE := -m "wire and not alone and not soak"
ALONE := tests/integration -m "alone and not soak"

.PHONY: demo test test-wire test-virtual test-lint lint soak bench docs wheelhouse deb image clean python

demo: $(VENV)/.ready
	$(BIN)/cellward demo

# What keeps real time comes first, one whole cell in motion at a time: a twin and a daemon use most of a core.
# The rest, which asks for nothing but time, fills what is left of both cores; it is shown when it has ended.
# So does what lint looks at: one process, beside which a core would stand still if the tests waited for it.
test: $(VENV)/.ready
	$(MAKE) --no-print-directory --jobs 3 test-wire test-virtual test-lint

test-wire: $(VENV)/.ready
	$(BIN)/pytest $(ALONE)
	$(BIN)/pytest $(WIRE) --numprocesses 2 --dist loadfile

test-virtual: $(VENV)/.ready
	@mkdir -p build
	@echo "virtual time: see build/virtual.log until it has ended"
	@nice -n 19 $(BIN)/pytest $(VIRTUAL) --numprocesses 2 --dist worksteal >build/virtual.log 2>&1; \
		status=$$?; cat build/virtual.log; exit $$status

test-lint: $(VENV)/.ready
	@mkdir -p build
	@echo "lint: see build/lint.log until it has ended"
	@nice -n 19 $(MAKE) --no-print-directory lint >build/lint.log 2>&1; \
		status=$$?; cat build/lint.log; exit $$status

lint: $(VENV)/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

soak: $(VENV)/.ready
	$(BIN)/pytest -m soak

bench: $(VENV)/.ready
	$(BIN)/python -m bench

docs: $(VENV)/.ready
	$(BIN)/python -m daemon.docs

# The program and all that it needs as wheels, for a PC without a network: cellward install --wheelhouse.
wheelhouse: $(VENV)/.ready
	rm -rf build/wheelhouse build/lib build/bdist.*
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --constraint constraints.txt \
		--wheel-dir build/wheelhouse '.[mqtt,mcap]'

deb: wheelhouse
	deploy/deb/build.sh $(BIN)/python build/wheelhouse build

# The twin in a container, or with IMAGE=ci what .ci/run needs: docs/container.md. It needs no Python here.
IMAGE ?= twin
ENGINE ?= $(shell command -v podman || command -v buildah || command -v docker)
image:
	@test -n "$(ENGINE)" || { echo "make image needs podman, buildah or docker, and there is none of them: \
	install one (on Debian and Ubuntu: apt-get install podman)" | tr -s '\t ' ' ' >&2; exit 1; }
	$(ENGINE) build --file deploy/Containerfile --target $(IMAGE) --tag cellward-$(IMAGE) $(IMAGE_OPTIONS) .

$(VENV)/.ready: pyproject.toml constraints.txt | python
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) setuptools wheel
	$(PIP) --no-build-isolation --editable '.[dev]'
	touch $@

python:
	@command -v $(PYTHON) >/dev/null || { echo "Cellward needs Python 3.11 or 3.12, and there is no $(PYTHON): \
	install one of them, or name it: make PYTHON=/path/to/python3.12" | tr -s '\t ' ' ' >&2; exit 1; }
	@$(PYTHON) -c "$$CHECK_PYTHON"
	@test ! -x $(BIN)/python || test "$$($(BIN)/python $(VERSION_OF))" = "$$($(PYTHON) $(VERSION_OF))" || \
		{ echo "$(VENV) holds another Python than $(PYTHON): run make clean first" >&2; exit 1; }

clean:
	rm -rf $(VENV) demo-out build *.egg-info

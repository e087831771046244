# Everything needs only make and a Python from 3.11 on: `make setup` builds .venv from requirements.lock.

SHELL := /bin/sh
BIN := .venv/bin
LOCKED := .venv/.locked
READY := .venv/.ready
PIP := $(BIN)/python -m pip -qq --disable-pip-version-check --no-input
KERNEL_TESTS := tests/test_kernels.py tests/test_interior_point.py

define CHECKS
{ $(BIN)/ruff format --quiet --check || { echo "Run: $(BIN)/ruff format" >&2; false; }; } \
&& $(BIN)/ruff check --quiet && $(BIN)/pyright --warnings \
&& { report=$$($(BIN)/lint-imports --no-cache --no-logo 2>&1) || { echo "$$report"; false; }; }
endef

# The lock is the only source of versions; no tool looks for newer ones.
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup demo test slow lint bench lock

help: ## Show the targets
	@sed -n 's/^\([a-z]*\):[^#]*## \(.*\)/  make \1	\2/p' $(MAKEFILE_LIST)

setup: $(READY) ## Create .venv with everything in it
	@:

$(LOCKED): requirements.lock
	@rm -f $@
	@for python in python3 python3.13 python3.12 python3.11 python; do \
		"$$python" -c 'import sys, ensurepip, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || continue; \
		echo "Creating .venv with $$("$$python" --version) (takes about a minute)"; \
		"$$python" -m venv --clear .venv && exit 0; \
	done; echo "No Python from 3.11 on with its venv module found; install one and retry." >&2; exit 1
	@$(PIP) install --require-hashes -r requirements.lock
	@touch $@

$(READY): $(LOCKED) pyproject.toml
	@$(PIP) install --no-deps --no-build-isolation --editable .
	@touch $@

demo: $(READY) ## Plan the half-cycle of a forwarder crane and write its report to demo/
	@$(BIN)/leanboom plan forwarder-half-cycle --out demo
	@echo "Open demo/report.html in a browser."

test: $(READY) ## Run the checks and, at the same time, all tests but the slow ones
	@( $(CHECKS) ) & checks=$$!; \
	$(BIN)/python -m pytest -q --numprocesses 2 --dist worksteal -m "not slow"; tests=$$?; \
	wait $$checks && exit $$tests

slow: $(READY) ## Run the slow tests, and those of the kernels with indices checked
	@NUMBA_BOUNDSCHECK=1 $(BIN)/python -m pytest -q --numprocesses 2 --dist loadfile $(KERNEL_TESTS)
	@$(BIN)/python -m pytest -q --numprocesses 2 --dist worksteal -m slow

lint: $(READY) ## Check format, style, types and layers
	@$(CHECKS)

bench: $(READY) ## Measure time, memory and energy
	@$(BIN)/python -m benchmarks.run
	@$(BIN)/python -m benchmarks.speed

lock: $(READY) ## Renew requirements.lock (needs uv)
	@uv --quiet pip compile pyproject.toml --group tests --group dev --extra library --extra cluster --extra logs --universal --fork-strategy fewest \
		--python-version 3.11 --upgrade --generate-hashes --no-emit-index-url --no-header --output-file requirements.lock

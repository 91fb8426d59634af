# Two commands matter: `make run` and `make test`. `make help` lists the rest.
# Each prepares what it needs in .venv the first time; stamp files make the second call immediate.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

PYTHON ?= $(shell command -v python3.11 || command -v python3 || echo python3)
VENV ?= .venv
PORT ?= 8000
ONCE ?=
SEED ?=
MODEL ?= models/vftm-dsl.onnx
EXPERIMENT ?= vftm-dsl-fast
EXTRAS := dev,training
PACKAGES := wire service sim_backend api training benchmarks cli
PINS ?= constraints.txt
BIN := $(VENV)/bin
RUNTIME := $(VENV)/.installed-runtime
TRAINING := $(VENV)/.installed-training
DEV := $(VENV)/.installed-dev
DOCS := $(VENV)/.installed-docs
INSTALLED_FROM := pyproject.toml constraints.txt setup.py $(wildcard sim_backend/world/compiled/*.[ch] service/policy/compiled/*.[ch] wire/*.h)
PIP := $(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: help
help: ## list the targets
	@grep -hE '^[a-z-]+:.*## ' Makefile | sed -E 's/^([a-z-]+):.*## /  \1\t/' | expand -t 20

# --- set-up ---------------------------------------------------------------------------------------------------------

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "make: $(PYTHON) is missing or older than Python 3.11; name another one with PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' \
	  || { echo "make: this Python cannot make virtual environments; on Debian: apt-get install python3-venv" >&2; exit 1; }
	@echo "creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV)

$(RUNTIME): $(INSTALLED_FROM) | $(BIN)/python
	@echo "installing what the cell needs at run time"
	@$(PIP) --editable .
	@touch $@

$(TRAINING): $(INSTALLED_FROM) | $(BIN)/python
	@echo "installing what training needs (torch among it)"
	@$(PIP) --editable '.[training]'
	@touch $@ $(RUNTIME)

$(DEV): $(INSTALLED_FROM) | $(BIN)/python
	@echo "installing what training, tests and linters need (torch among it)"
	@$(PIP) --editable '.[$(EXTRAS)]'
	@touch $@ $(RUNTIME) $(TRAINING)

$(DOCS): $(INSTALLED_FROM) | $(BIN)/python
	@echo "installing what the documentation site needs"
	@$(PIP) --editable '.[docs]'
	@touch $@ $(RUNTIME)

.PHONY: setup setup-training setup-dev
setup: $(RUNTIME) ## prepare .venv for the cell
setup-training: $(TRAINING) ## prepare .venv for training as well
setup-dev: $(DEV) ## prepare .venv for everything

# What this machine's pip takes, in a fresh environment, from the ranges of pyproject.toml. A build's own suffix
# (torch's +cpu) is no part of a pin, and neither is an address: a line with one ends the recipe.
.PHONY: constraints
constraints: ## renew the pins (PINS=constraints.txt)
	@fresh=$$(mktemp -d); trap 'rm -rf "$$fresh"' EXIT; \
	$(PYTHON) -m venv "$$fresh/venv"; \
	"$$fresh/venv/bin/python" -m pip install --quiet --quiet --disable-pip-version-check --editable '.[$(EXTRAS),docs]'; \
	{ grep '^#' constraints.txt; \
	  "$$fresh/venv/bin/python" -m pip freeze --exclude-editable | sed -E 's/\+[A-Za-z0-9.]+$$//'; } > "$$fresh/pins"; \
	if grep -nE ' @ |://' "$$fresh/pins"; then echo "make: these lines are no pins; nothing was written" >&2; exit 1; fi; \
	cp "$$fresh/pins" $(PINS)

# --- the cell -------------------------------------------------------------------------------------------------------

.PHONY: run
run: $(RUNTIME) ## start the simulated cell and insert one peg (ONCE=1: then exit; PORT=8000; SEED=3)
	@exec $(BIN)/dsl-assembly demo --port $(PORT) $(if $(ONCE),--once) $(if $(SEED),--seed $(SEED))

# --- checks ---------------------------------------------------------------------------------------------------------

.PHONY: test test-covered coverage nightly lint format docs-check
# Tests that live by the host's clock run alone, and once more where they failed: a machine that is late for a moment
# fails one of them, a fault fails twice. The others share the cores. Bytecode is kept, since every process of a
# test would compile all modules again.
test: export PYTHONDONTWRITEBYTECODE =
test: $(DEV) ## the tests (some twenty minutes on two cores; ARGS=tests/wire: these alone)
ifdef ARGS
	$(BIN)/python -m pytest $(ARGS)
else
	$(BIN)/python -m pytest --numprocesses auto --dist worksteal -m "not realtime and not nightly"
	$(BIN)/python -m pytest -m "realtime and not nightly" || \
	$(BIN)/python -m pytest -m "realtime and not nightly" --last-failed --last-failed-no-failures none
endif

test-covered: $(DEV) ## the same tests one after another under coverage, then a line per package
	$(BIN)/python -m coverage run --source "$$(tr ' ' , <<< '$(PACKAGES)')" -m pytest --timeout 300 $(ARGS)
	@echo "branch coverage; what the tests run in other processes is not counted"
	@total() { $(BIN)/python -m coverage report --format total --precision 1 "$$@"; }; \
	for package in $(PACKAGES); do printf '  %-12s %5s %%\n' "$$package" "$$(total --include "$$package/*")"; done; \
	printf '  %-12s %5s %%\n' together "$$(total)"

coverage: $(DEV) ## every branch of the safety core is exercised by its own tests
	$(BIN)/python -m coverage run --source service.safety --data-file .coverage-safety -m pytest -q tests/service/safety
	$(BIN)/python -m coverage report --data-file .coverage-safety --fail-under 100

nightly: $(DEV) ## 10,000 simulated universes, the state machine at length, every fault put back, mutation testing, coverage (hours)
	$(BIN)/python -m tests.simulation --seeds 10000
	$(BIN)/python -m pytest -m nightly tests/simulation tests/sim_backend/world/compiled
	$(BIN)/python -m tests.mutation
	$(MAKE) test-covered

lint: $(DEV) ## ruff, import directions, pyright
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright

format: $(DEV) ## let ruff put the layout right
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs-check: $(DEV) ## links between documents, the documents that must exist, their examples and commands
	$(BIN)/python -m pytest -q tests/test_architecture.py -k document
	$(BIN)/python -m pytest -q tests/docs

# --- documentation --------------------------------------------------------------------------------------------------

.PHONY: docs docs-serve
docs: $(DOCS) ## build the documentation site into site/; a broken link is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --clean

docs-serve: docs ## look at the site on http://127.0.0.1:8001 until Ctrl-C
	$(BIN)/python -m http.server 8001 --bind 127.0.0.1 --directory site

# --- training and measurements --------------------------------------------------------------------------------------

.PHONY: train evaluate reproduce report benchmark
train: $(TRAINING) ## train an experiment, or go on with it (EXPERIMENT=vftm-dsl-fast: ten minutes; ARGS=--help)
	$(BIN)/dsl-assembly train $(EXPERIMENT) $(ARGS)

evaluate: $(TRAINING) ## success over fresh seeds, with intervals (ARGS="MODEL --episodes 500 ..."; ARGS=--help)
	$(BIN)/dsl-assembly evaluate $(or $(ARGS),$(MODEL))

reproduce: $(TRAINING) ## play every episode of the report again, compare, report into var/reproduced (ARGS=--help)
	$(BIN)/dsl-assembly reproduce $(ARGS)

report: $(TRAINING) ## write docs/results.html and docs/results.md from results/ (ARGS=--help)
	$(BIN)/dsl-assembly report $(ARGS)

benchmark: $(TRAINING) ## measure, print the tables, save them in benchmarks/results/ (ARGS=--help)
	$(BIN)/dsl-assembly bench $(ARGS)

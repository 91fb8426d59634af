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
BIN := $(VENV)/bin
RUNTIME := $(VENV)/.installed-runtime
TRAINING := $(VENV)/.installed-training
DEV := $(VENV)/.installed-dev
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

$(RUNTIME): pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing what the cell needs at run time"
	@$(PIP) --editable .
	@touch $@

$(TRAINING): pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing what training needs (torch among it)"
	@$(PIP) --editable '.[training]'
	@touch $@ $(RUNTIME)

$(DEV): pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing what training, tests and linters need (torch among it)"
	@$(PIP) --editable '.[dev,training]'
	@touch $@ $(RUNTIME) $(TRAINING)

.PHONY: setup setup-training setup-dev
setup: $(RUNTIME) ## prepare .venv for the cell
setup-training: $(TRAINING) ## prepare .venv for training as well
setup-dev: $(DEV) ## prepare .venv for everything

# --- the cell -------------------------------------------------------------------------------------------------------

.PHONY: run
run: $(RUNTIME) ## start the simulated cell and insert one peg (ONCE=1: then exit; PORT=8000; SEED=3)
	@exec $(BIN)/dsl-assembly demo --port $(PORT) $(if $(ONCE),--once) $(if $(SEED),--seed $(SEED))

# --- checks ---------------------------------------------------------------------------------------------------------

.PHONY: test test-slow coverage lint format docs-check
test: $(DEV) ## the tests (minutes)
	$(BIN)/python -m pytest -m 'not slow' $(ARGS)

test-slow: $(DEV) ## the tests marked slow
	$(BIN)/python -m pytest -m slow --timeout 1800 $(ARGS)

coverage: $(DEV) ## every branch of the safety core is exercised by its own tests
	$(BIN)/python -m coverage run -m pytest -q tests/service/safety
	$(BIN)/python -m coverage report

lint: $(DEV) ## ruff, import directions, pyright
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright

format: $(DEV) ## let ruff put the layout right
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs-check: $(DEV) ## links between documents, and the documents that must exist
	$(BIN)/python -m pytest -q tests/test_architecture.py -k document

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

# Every target sets up its own virtual environment when it is missing or out of date.
# The newest supported Python that runs; a name on the PATH may be a shim of one that is not there.
PYTHON ?= $(or $(firstword $(foreach v,3.13 3.12 3.11,$(shell python$(v) -c "" 2>/dev/null && echo python$(v)))),python3)
VENV ?= .venv
BIN := $(VENV)/bin
SCENARIO ?= chatelain2013_fig5
ARGS ?=

SHELL := /bin/bash
# Programs start three times as fast from compiled modules, which pip leaves to the first import.
unexport PYTHONDONTWRITEBYTECODE
.PHONY: help compile run test test-slow test-quick fuzz bench docs notebooks pictures lint clean
.PRECIOUS: $(VENV)/.installed.%
.DEFAULT_GOAL := help

help:
	@echo "make run    simulate $(SCENARIO): the robot finds a needle and follows it"
	@echo "make test   run the tests            make bench  run the benchmarks"
	@echo "make test-slow   run the studies of minutes that make test leaves out (hours)"
	@echo "make fuzz   damage files, scenarios and commands at random (an hour)"
	@echo "make lint   ruff, mypy, imports      make clean  remove what was built"
	@echo "make docs   build the documentation in build/docs"
	@echo "make notebooks   run the notebooks   make pictures   take the README's screens"

# Development tools are installed together with the rest where they are needed: one call of pip.
EXTRAS := $(if $(filter-out help compile run docs clean,$(MAKECMDGOALS))$(wildcard $(VENV)/.installed.dev),dev,run)

$(VENV)/.installed.%: pyproject.toml setup.py
	@echo "Setting up $(VENV): sonoservo and what it needs (about a minute if pip has it in its cache) ..."
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v <= (3, 13) else "sonoservo needs Python 3.11 to 3.13; this is %d.%d" % v)'
	@$(PYTHON) -m venv $(VENV) || { echo "Could not make $(VENV): on Debian or Ubuntu, install the package python3-venv."; exit 1; }
	@set -o pipefail; $(BIN)/python -m pip install --no-compile --progress-bar off --disable-pip-version-check --editable \
		'.$(if $(filter dev,$*),[dev])' | sed -un 's/^ *\(Downloading\|Using cached\) \(.* MB)\)$$/  \2/p; s/^Installing collected.*/  Installing .../p'
	@touch $@

$(VENV)/.compiled: pyproject.toml setup.py | $(VENV)/.installed.$(EXTRAS)
	@$(BIN)/sonoservo compile $(if $(filter dev,$(EXTRAS)),--all)
	@touch $@

compile: $(VENV)/.compiled

run: $(VENV)/.compiled
	@$(BIN)/sonoservo run $(SCENARIO) $(ARGS)

# Whole loops come first in the alphabet, so that neither worker ends with a long one.
test: $(VENV)/.installed.dev $(VENV)/.compiled
	@$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --ignore=tests/benchmarks -rs $(ARGS)

# What judges a behaviour over many seeds or minutes; a quick form of each is among the tests.
test-slow: $(VENV)/.installed.dev $(VENV)/.compiled
	@$(BIN)/python -m pytest -m slow -n 2 --dist loadscope -rs $(ARGS)

# A few of the tests on another Python, and so another Drake, in an environment of its own.
QUICK := tests/systems/robot tests/systems/control tests/systems/signals tests/systems/needle tests/systems/files \
	tests/diagrams/test_station.py tests/diagrams/test_wiring.py tests/diagrams/test_probe_controller.py
test-quick: $(VENV)/.installed.dev
	@$(BIN)/ruff check . && $(BIN)/ruff format --check .
	@$(BIN)/python -m pytest -n 2 --dist loadfile $(QUICK) $(ARGS)

fuzz: $(VENV)/.installed.dev
	@PYTHONPATH=tests/helpers:tests/tools $(BIN)/python -m fuzzing $(ARGS)

bench: $(VENV)/.installed.dev $(VENV)/.compiled
	@mkdir -p out
	@$(BIN)/python -m pytest -q tests/benchmarks -m "not slow or bench" --benchmark-enable --benchmark-only --benchmark-quiet \
		--benchmark-min-rounds=3 --benchmark-max-time=0.5 --benchmark-json=out/bench.json $(ARGS); \
	status=$$?; $(BIN)/python tests/benchmarks/table.py out/bench.json && exit $$status

docs: $(VENV)/.compiled
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@$(BIN)/sphinx-build -q -W -E -b html notebooks/docs build/docs
	@echo "Written: build/docs/index.html"

# The notebooks are written as scripts; what Jupyter opens is made of them, with its outputs.
notebooks: $(VENV)/.installed.dev $(VENV)/.compiled
	@$(BIN)/python notebooks/execute.py $(ARGS)

pictures: $(VENV)/.installed.dev
	@$(BIN)/python notebooks/screenshots.py
	@$(BIN)/python notebooks/moving_picture.py
	@$(BIN)/python notebooks/ports.py
	@cd notebooks && $(abspath $(BIN))/python gallery.py
	@mkdir -p out && cd out && $(abspath $(BIN))/python ../notebooks/gallery_of_dials.py

# mypy and import-linter find packages by folder: the links give them the name that pyproject.toml
# maps to this folder.
lint: $(VENV)/.installed.dev
	@$(BIN)/ruff check . && $(BIN)/ruff format --check .
	@mkdir -p build/typing/sonoservo
	@ln -sfn $(CURDIR)/systems $(CURDIR)/diagrams $(CURDIR)/models build/typing/sonoservo/
	@MYPYPATH=build/typing $(BIN)/mypy -p sonoservo
	@PYTHONPATH=build/typing $(BIN)/lint-imports --no-logo --no-cache

clean:
	rm -rf $(VENV) out build *.egg-info .pytest_cache .mypy_cache .ruff_cache .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

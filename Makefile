# Everything from a fresh clone: Python 3.11 with pip is all it takes.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN = .venv/bin
# Tests and the demo never phone home.
export MLFLOW_DISABLE_TELEMETRY = true
# Tests start many processes: what they import is compiled once, whatever the environment says.
export PYTHONDONTWRITEBYTECODE =

.PHONY: help demo docs lab real test test-long types format

help: ## what there is to make
	@sed -n 's/^\([a-z-]*\):.*## /\1	/p' $(MAKEFILE_LIST)

demo: .venv/installed ## the whole path on the sample that ships, in minutes
	$(BIN)/softslide demo --out demo

docs: .venv/docs-installed ## these pages as a site, its examples run: docs/_build/docs/index.html
	$(BIN)/sphinx-build -q -W --keep-going -c docs . docs/_build

# Its environment is its own: what OctoPrint needs is not what softslide needs.
lab: .venv/installed .octoprint/installed ## a recording session with a printer as the stage, simulated, in minutes
	$(BIN)/python -m softslide.experiments.studies.lab --printer .octoprint/bin/python --out lab

# `evaluate` scores no bound of the article's on curves, which is no failure here.
real: .venv/installed ## the table of docs/real.md, in hours
	$(BIN)/softslide import pipeline/presses/run2_20250317_fixed_depth.csv --map pipeline/presses/one.toml --out real/one
	$(BIN)/softslide import pipeline/presses/run2_20250317_fixed_depth.csv --map pipeline/presses/five.toml --out real/five
	$(BIN)/softslide import pipeline/presses/run2_20250317_fixed_depth.csv --map pipeline/presses/few.toml --out real/few
	$(BIN)/softslide compare --recordings real/one real/five --models trees inversion cnn --out real/comparison
	$(BIN)/python -m softslide.experiments.studies.few_recordings --recordings real/few --slides 48 12 --draws 1
	$(BIN)/softslide evaluate --model real/comparison/one/cnn/bundle --recordings real/one --split track-circle track-s --out real/curves-one --allow-untested
	$(BIN)/softslide evaluate --model real/comparison/five/cnn/bundle --recordings real/five --split track-circle track-s --out real/curves-five --allow-untested

test: .venv/installed ## linters, types, import contracts, tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(MAKE) types
	$(BIN)/pytest -n 3 --dist loadfile

types: .venv/installed ## types and import contracts, on the package as it is when installed, by links
	$(BIN)/python tests/worlds/linked.py .linked
	$(BIN)/mypy
	cd .linked && ../$(BIN)/lint-imports --config ../pyproject.toml

test-long: .venv/installed ## tests that take minutes each
	$(BIN)/pytest -m long --timeout 7200

format: .venv/installed ## format the code
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Older than the pins counts as missing; the marker is touched last, so a broken install is taken up again.
.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "softslide needs Python 3.11 or newer")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --no-compile -c constraints.txt -e ".[all]"
	touch $@

.venv/docs-installed: .venv/installed
	$(BIN)/python -m pip install --quiet --no-compile -c constraints.txt -e ".[docs]"
	touch $@

.octoprint/installed:
	$(PYTHON) -m venv .octoprint
	.octoprint/bin/python -m pip install --quiet --no-compile OctoPrint==1.11.8
	touch $@

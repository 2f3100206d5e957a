# Everything from a fresh clone: Python 3.11 with pip is all it takes.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN = .venv/bin
# Tests and the demo never phone home.
export MLFLOW_DISABLE_TELEMETRY = true

.PHONY: demo test test-long format

demo: .venv/installed
	$(BIN)/softslide demo --out demo

test: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest -n 2 --dist loadfile

test-long: .venv/installed
	$(BIN)/pytest -m long

format: .venv/installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Older than the pins counts as missing; the marker is touched last, so a broken install is taken up again.
.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "softslide needs Python 3.11 or newer")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[all]"
	touch $@

# One command for each daily task. Everything lives in .venv; `make clean` forgets it.
PYTHON ?= python3
BIN = .venv/bin

.PHONY: demo studio setup test test-all check docs bench clean

demo: .venv/runtime  ## set up, run the built-in example, name its report
	$(BIN)/cagemap demo -o demo

studio: .venv/runtime  ## the built-in pair in the browser
	$(BIN)/python -m pip install --quiet -e ".[studio]"
	$(BIN)/cagemap studio

test: .venv/develop  ## set up, run the tests (slow ones left out)
	$(BIN)/python -m pytest

setup: .venv/develop  ## everything a developer needs

test-all: .venv/develop  ## the slow tests too
	$(BIN)/python -m pytest -m "slow or not slow"

check: .venv/develop  ## format, lint, types, import rules
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: .venv/develop  ## docs/_build/html, warnings are errors
	$(BIN)/sphinx-build -W --keep-going -b html docs docs/_build/html

bench: .venv/develop  ## measured tables
	$(BIN)/python -m benchmarks

clean:
	rm -rf .venv demo docs/_build

.venv/runtime: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet -e .
	touch $@

.venv/develop: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet -e ".[studio,test,lint,docs]"
	touch $@ .venv/runtime

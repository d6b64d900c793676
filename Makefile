# One command for each daily task. Everything lives in .venv; `make clean` forgets it.
PYTHON ?= python3
BIN = .venv/bin
EXTRAS =
# uv takes a fifth of pip's time. It does not read pip's settings: where it reaches no registry, pip installs.
install = $(BIN)/python -m pip install --quiet uv && $(BIN)/uv pip install --quiet --python $(BIN)/python -e ".$(EXTRAS)" \
	|| $(BIN)/python -m pip install --quiet -e ".$(EXTRAS)"

.PHONY: demo studio setup test test-all check docs bench blender test-blender clean

demo: .venv/runtime  ## set up, run the built-in example, name its report
	$(BIN)/cagemap demo -o demo

studio: EXTRAS = [studio]
studio: .venv/runtime  ## the built-in pair in the browser
	$(install)
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

blender: .venv/develop  ## dist/cagemap-*.zip, the extension for every Blender and platform
	$(BIN)/python blender/build.py

# Blender as a package, 400 MB; of Blender 4.2: make test-blender BPY="bpy==4.2.* numpy==1.24.3"
# of Blender 5.1: make test-blender BPY="bpy==5.1.*" BPY_PYTHON=python3.13
BPY ?= bpy==5.0.*
BPY_PYTHON ?= python3.11

test-blender: .venv/develop  ## install the extension in a fresh profile of Blender and press every button
	$(BPY_PYTHON) -m venv --clear .venv/bpy
	.venv/bpy/bin/python -m pip install --quiet $(BPY)
	CAGEMAP_BPY=$(CURDIR)/.venv/bpy/bin/python $(BIN)/python -m pytest -n 0 -m "slow or not slow" tests/blender

clean:
	rm -rf .venv demo dist docs/_build

.venv/runtime: pyproject.toml
	$(PYTHON) -m venv .venv
	$(install)
	touch $@

.venv/develop: EXTRAS = [studio,test,lint,docs]
.venv/develop: pyproject.toml
	$(PYTHON) -m venv .venv
	$(install)
	touch $@ .venv/runtime

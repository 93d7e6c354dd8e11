# Everything happens in .venv, from requirements with hashes; only python3 (>= 3.11), make and a
# network are needed. A stamp says that .venv matches a requirements file: repeated calls are quick.

PYTHON ?= python3
UV ?= uv
BIN := .venv/bin
WHEEL := build/wheel
LOCK = $(UV) pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes \
	--fork-strategy fewest --no-header --no-emit-index-url --no-emit-find-links --quiet $(UPGRADE)
HALF := $(BIN)/python -m pytest --cov --cov-report= --cov-fail-under=0
INSTALL := $(BIN)/python -m pip --disable-pip-version-check install --quiet

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help test lint wheel-test demo paper bench golden lock clean

help:
	@echo 'make demo        calibrate a pretend robot and write its report to ftcal-out/demo'
	@echo 'make paper       the paper, end to end, on a simulated robot: ftcal-out/paper/study.html'
	@echo 'make test        style, types, layers, then the tests against the built wheel'
	@echo 'make lint        style, types and layers only'
	@echo 'make wheel-test  build the wheel and import every module from it'
	@echo 'make bench       every benchmark beside its baseline (BENCH="--only reading", --quick, ...)'
	@echo 'make golden      rewrite the golden files; read the difference before committing'
	@echo 'make lock        compile requirements/ from pyproject.toml (UPGRADE=--upgrade for newer)'
	@echo 'make clean       remove what these commands made'
	@echo 'PYTHON=...       the interpreter that makes .venv (now: $(PYTHON))'

# Two halves at once, a core each; that of the first is printed when both are done.
test: lint wheel-test
	@rm -f .coverage .coverage.*
	@export PYTHONPATH="$(CURDIR)/$(WHEEL)"; \
	COVERAGE_FILE=.coverage.first $(HALF) tests/test_[a-q]*.py > build/first.log 2>&1 & first=$$!; \
	COVERAGE_FILE=.coverage.second $(HALF) tests/test_[r-z]*.py; second=$$?; \
	wait $$first; first=$$?; cat build/first.log; exit $$((first + second))
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report

lint: .venv/dev.stamp
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

# The wheel is unpacked ahead of the editable install on the path, so that a file the wheel forgot
# is missed here rather than by a user.
wheel-test: .venv/dev.stamp
	rm -rf build/dist $(WHEEL)
	$(BIN)/python -m hatchling build --target wheel --directory build/dist
	$(INSTALL) --no-deps --no-index --no-compile --target $(WHEEL) build/dist/*.whl
	PYTHONPATH="$(CURDIR)/$(WHEEL)" $(BIN)/python -m ftcal.cli --version
	PYTHONPATH="$(CURDIR)/$(WHEEL)" $(BIN)/python tests/wheel_imports.py $(WHEEL)

demo: .venv/run.stamp
	$(BIN)/ftcal demo -o ftcal-out/demo

paper: .venv/run.stamp
	rm -rf ftcal-out/paper
	$(BIN)/ftcal simulate examples/paper/session.toml -o ftcal-out/paper/session
	$(BIN)/ftcal study examples/paper/job.toml -o ftcal-out/paper

bench: .venv/dev.stamp
	$(BIN)/python benchmarks/run.py $(BENCH)

golden: .venv/dev.stamp
	FTCAL_GOLDEN=update $(BIN)/python -m pytest
	@git status --short tests || true

lock:
	@command -v $(UV) >/dev/null || { echo "make lock needs uv: pip install uv, or UV=/path/to/uv"; exit 1; }
	$(LOCK) --all-extras --group test --group lint --group build --output-file requirements/dev.txt
	$(LOCK) --extra demo --group build --constraints requirements/dev.txt \
		--output-file requirements/run.txt

clean:
	rm -rf .venv build dist ftcal-out .coverage .coverage.* .mypy_cache .ruff_cache .pytest_cache \
		.hypothesis .import_linter_cache

.venv/python.stamp:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "ftcal needs Python >= 3.11, $(PYTHON) is not: make PYTHON=/path/to/python3.11"; exit 1; }
	@$(PYTHON) -m venv --clear .venv || { \
		echo "$(PYTHON) cannot make a virtual environment; on Debian and Ubuntu: apt install python3-venv"; \
		exit 1; }
	@touch $@

# No build dependency is fetched unseen: wheels only, and hatchling is among the requirements.
.venv/run.stamp: .venv/python.stamp requirements/run.txt pyproject.toml
	$(INSTALL) --require-hashes --only-binary :all: --requirement requirements/run.txt
	$(INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@

# dev.txt holds all of run.txt at the same versions.
.venv/dev.stamp: .venv/python.stamp requirements/dev.txt pyproject.toml
	$(INSTALL) --require-hashes --only-binary :all: --requirement requirements/dev.txt
	$(INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@ .venv/run.stamp

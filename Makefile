# The commands of the project; `make help` lists them.

SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory
.DELETE_ON_ERROR:

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
WORKERS ?= 2
# Two workers, each on one thread of its own. Compiled modules are kept even where the environment says
# otherwise: each of the many processes compiled all anew.
TEST_ENV := NUMBA_NUM_THREADS=1 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 \
	PYTHONDONTWRITEBYTECODE=
# A test that hangs ends its worker and is named; by a thread, as the program limits reading with the alarm signal.
IF_IT_HANGS := --timeout-method=thread --max-worker-restart=0
# Held back so that mlflow 3.17 fits into the same lock, and so that torch stays the build for CPUs: later
# ones bring 3 GB of CUDA.
HELD_BACK := 'pyarrow<26' 'python-dateutil<3' 'torch==2.13.0'

# Measured data sets beside the checkout, where there are any.
ifndef SPIRAL_DATA
ifneq ($(wildcard ../shared/data/.),)
export SPIRAL_DATA := $(abspath ../shared/data)
endif
endif

# The first Python that runs, is 3.11 or newer and can make environments; 3.11 itself if present.
FIND_PYTHON = for python in python3.11 python3 /usr/bin/python3.11 /usr/bin/python3; do \
	if "$$python" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' \
		>/dev/null 2>&1; then echo "$$python"; exit; fi; done; \
	echo 'needed: Python 3.11 or newer with venv (Debian: apt install python3.11-venv)' >&2; exit 1

.PHONY: help setup demo published app test test-slow docs pictures bench lint licenses format lock clean

help: ## List these commands
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

setup: $(VENV)/.installed ## Make .venv with the locked versions and install the package (HASHES=1: of these very wheels)

# ensurepip writes pip last, so its presence means a complete environment.
$(BIN)/pip:
	@python="$$($(FIND_PYTHON))" && echo "setup: .venv from $$("$$python" -V)" \
		&& "$$python" -m venv $(VENV)

# The lock has two parts: up to the mark what the program needs, then what the other targets need.
LOCK = $(if $(HASHES),requirements.hashes.lock,requirements.lock)
MARK := ^\# For tests
# The lock is complete, so nothing is left to resolve.
INSTALL = $(PIP) install --no-deps --no-compile $(if $(HASHES),--require-hashes) --requirement

# Imported once, all is compiled and kept: where the environment forbids to keep it, every command
# would compile it anew, for some seconds.
IMPORT_ALL = import importlib, pkgutil, spiral; \
	names = [m.name for m in pkgutil.walk_packages(spiral.__path__, 'spiral.')]; \
	[importlib.import_module(n) for n in names if not n.endswith('__main__')]; \
	import mlflow.store.tracking.sqlalchemy_store

$(VENV)/.locked: requirements.lock | $(BIN)/pip
	@sed '/$(MARK)/,$$d' $(LOCK) > $(VENV)/part
	@echo "setup: $$(grep -c == $(VENV)/part) locked packages (a minute or so the first time)"
	@$(INSTALL) $(VENV)/part
	@touch $@

$(VENV)/.dev: requirements.lock $(VENV)/.installed
	@sed '1,/$(MARK)/d' $(LOCK) > $(VENV)/part
	@echo "setup: $$(grep -c == $(VENV)/part) more for tests, checks and documents"
	@$(INSTALL) $(VENV)/part
	@touch $@

$(VENV)/.installed: $(VENV)/.locked pyproject.toml setup.py
	@echo "setup: the package itself"
	@PYTHONWARNINGS='ignore:Editable installation' $(PIP) install --no-deps --no-build-isolation --editable .
	@echo "setup: compiling what it imports"
	@PYTHONDONTWRITEBYTECODE= $(BIN)/python -c "$(IMPORT_ALL)"
	@touch $@

demo: setup ## Find what the rotor's model is missing, on the embedded record
	@$(BIN)/spiral discover experiment=rotor_coastdown

published: setup ## The demo's record by the paper's evidence, beside the demo's answer (after make demo)
	@$(BIN)/python -m experiments.side_by_side runs

app: setup ## Open the page: see where the model fails, click Add, watch the error fall
	@$(BIN)/spiral app

# Every module with a loop that Numba compiles and keeps.
COMPILED := spiral.physics.compile spiral.engine.kernel spiral.engine.filter.kernel spiral.engine.filter.smoother \
	spiral.engine.filter.slopes_kernel spiral.engine.filter.stochastic_kernel spiral.engine.filter.unscented \
	spiral.engine.likelihood.kernel spiral.engine.likelihood.signatures_kernel

# Compiled once here, so that the workers find the cache instead of compiling side by side.
.PHONY: warm dev
dev: $(VENV)/.dev
warm: dev
	@echo "test: compiled kernels"
	@$(BIN)/python -c '$(foreach module,$(COMPILED),import $(module);)'

# Files in the order of tests/conftest.py, not by their number of tests.
test: warm ## Run the tests (without the slow ones)
	@echo "test: pytest with $(WORKERS) workers, slow tests left out"
	@$(TEST_ENV) $(BIN)/python -m pytest -q -m 'not slow' -n $(WORKERS) --timeout=900 $(IF_IT_HANGS) \
		--dist loadfile --no-loadscope-reorder $(PYTEST)

test-slow: warm ## Run the slow tests: statistics, whole studies, every tab of the page
	@echo "test: pytest with $(WORKERS) workers, slow tests only"
	@$(TEST_ENV) $(BIN)/python -m pytest -q -m slow --ignore=tests/browser -n $(WORKERS) --timeout=3600 $(IF_IT_HANGS) \
		--dist worksteal $(PYTEST)
	@echo "test: all tests of the page, which go on where the one before ended"
	@$(TEST_ENV) $(BIN)/python -m pytest -q -n $(WORKERS) --timeout=3600 $(IF_IT_HANGS) --dist loadfile $(PYTEST) tests/browser

# Notebooks are executed where they or the package changed; their outputs are kept.
docs: warm ## Build the documentation into site/ (no network; some two minutes the first time)
	@echo "docs: mkdocs, strict"
	@$(TEST_ENV) NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet
	@echo "docs: open site/index.html"

pictures: dev ## Draw the README's pictures anew (needs a Chromium)
	@$(BIN)/python docs/pictures/make.py

bench: warm ## Measure speed (benchmarks/)
	@echo "bench: benchmarks/run.py"
	@$(BIN)/python benchmarks/run.py
	@echo "bench: benchmarks/sweep.py"
	@$(BIN)/python benchmarks/sweep.py
	@echo "bench: benchmarks/batch.py"
	@$(BIN)/python benchmarks/batch.py
	@echo "bench: benchmarks/scaling.py"
	@$(BIN)/python benchmarks/scaling.py

# All four run even where an earlier one fails; the last line says which did.
lint: dev ## Check format, rules, types and layers
	@failed=; \
	check() { echo "lint: $$1"; shift; "$$@" || failed="$$failed $$(basename $$1)"; }; \
	check 'format (ruff format)' $(BIN)/ruff format --check --output-format concise .; \
	check 'rules (ruff check)' $(BIN)/ruff check --quiet --output-format concise .; \
	check 'types (pyright)' $(BIN)/pyright; \
	check 'layers (lint-imports)' $(BIN)/lint-imports --no-logo; \
	if [ -n "$$failed" ]; then echo "lint: failed:$$failed" >&2; exit 1; fi; echo 'lint: clean'

licenses: setup ## List the licence of every package it runs with; fail where one is copyleft
	@$(BIN)/python .ci/licenses.py

format: dev ## Format the code and apply the safe fixes
	@$(BIN)/ruff check --quiet --fix-only .
	@$(BIN)/ruff format --quiet .

lock: ## Resolve every version anew into requirements.lock
	@python="$$($(FIND_PYTHON))"; folder="$$(mktemp -d)"; trap 'rm -rf "$$folder"' EXIT; \
	echo 'lock: resolving in a fresh environment'; \
	"$$python" -m venv "$$folder"; pip="$$folder/bin/python -m pip --quiet --disable-pip-version-check"; \
	$$pip install --upgrade pip; \
	"$$folder/bin/python" -c 'import tomllib; p = tomllib.load(open("pyproject.toml", "rb"))["project"]; print(*p["dependencies"], *p["optional-dependencies"]["dev"], sep="\n")' > "$$folder/wanted"; \
	$$pip install --upgrade --requirement "$$folder/wanted" $(HELD_BACK); \
	"$$folder/bin/python" -m pip freeze --all | "$$folder/bin/python" .ci/sections.py > "$$folder/lock"; \
	mv "$$folder/lock" requirements.lock; \
	"$$folder/bin/python" .ci/hashes.py requirements.lock > "$$folder/hashes"; \
	mv "$$folder/hashes" requirements.hashes.lock; echo "lock: $$(grep -c == requirements.lock) versions"

clean: ## Remove the environment, caches and build folders
	@rm -rf $(VENV) build dist site docs/tools/.cache *.egg-info .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

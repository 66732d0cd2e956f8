# Two commands matter: `make demo` and `make test`. Each sets up what it needs.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Nothing is installed or built but what requirements/ has the hash of: docs/installed.md.
PIP := PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python -m pip --disable-pip-version-check install --quiet \
	--no-deps --no-build-isolation --no-compile
LOCKED := $(PIP) --require-hashes -r requirements
CORE := $(VENV)/.core-installed
FULL := $(VENV)/.full-installed
COMPILED := $(VENV)/.compiled
# Tests start hundreds of processes: modules are compiled once, whatever the shell says.
export PYTHONDONTWRITEBYTECODE :=
SOURCES := $(shell find acquisition calibration simulation analysis hil_mocks -name '*.py')

.PHONY: demo paper test check setup lint coverage docs bench fuzz lock licences sbom wheel-check clean

demo: $(CORE)  ## The whole chain on the simulated bench; needs no system package.
	$(BIN)/standoff demo --out demo-output

paper: $(FULL)  ## The paper's tables and figures on the simulated bench: up to an hour.
	$(BIN)/standoff paper --out paper-output

# Three workers for two processors: one of them mostly waits for devices and browsers.
test: $(FULL) $(COMPILED)  ## Lint, types, layers and every test, the fast ones first.
	$(MAKE) --no-print-directory lint
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 3 --dist worksteal

# What to run after each change: a few minutes.
check: $(FULL) $(COMPILED)  ## Lint, types, layers and the fast tests.
	$(MAKE) --no-print-directory lint
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 3 --dist worksteal -m "not slow and not waits"

setup: $(FULL) $(COMPILED)  ## Everything, in .venv.

lint: $(FULL)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

coverage: $(FULL)  ## What the tests reach, by statement and branch: at least 90 % a package.
	@bash scripts/coverage.sh

docs: $(FULL)  ## The documentation as a site, in build/site/index.html.
	$(BIN)/sphinx-build -q -W --keep-going -c docs -b html . build/site

bench: $(FULL)  ## Speed and accuracy beside their peers, as ratios.
	$(BIN)/python -m benchmarks --jobs 2 --page docs/benchmarks.md

MINUTES ?= 10
fuzz: $(FULL)  ## Search with new input for what crashes a reader or breaks a property, by the clock.
	$(BIN)/python -m tests.fuzz --minutes $(MINUTES)

lock: $(FULL)  ## Make requirements/ from pyproject.toml; UPGRADE=--upgrade takes newer versions.
	$(BIN)/python -m scripts.lock $(UPGRADE)

licences: $(FULL)  ## Every installed package with its licence; fails on one that we cannot take.
	$(BIN)/python -m scripts.licences

sbom: $(FULL)  ## The bill of materials (CycloneDX), in build/sbom.cdx.json.
	$(BIN)/python -m scripts.bill_of_materials --out build/sbom.cdx.json

wheel-check: $(CORE)  ## Build the wheel, install it on every Python that is here, and use it there.
	$(BIN)/python -m scripts.try_wheel

clean:
	rm -rf $(VENV) build demo-output paper-output

$(CORE): pyproject.toml requirements/build.txt requirements/core.txt
	@sh scripts/check-python.sh $(PYTHON)
	@echo "Setting up the core environment in $(VENV) ..."
	$(PYTHON) -m venv $(VENV)
	$(LOCKED)/build.txt
	$(LOCKED)/core.txt
	$(PIP) -e .
	@touch $@

# Compiled by one process, once, and not by every test that comes first.
$(COMPILED): $(SOURCES) | $(FULL)
	@$(BIN)/python -m standoff.warm_up
	@touch $@

$(FULL): $(CORE) $(wildcard requirements/*.txt) scripts/install-system-packages.sh
	@sh scripts/install-system-packages.sh
	@echo "Setting up the full environment in $(VENV) ..."
	$(LOCKED)/full.txt
	$(LOCKED)/gobject.txt
	$(LOCKED)/$$($(BIN)/python -m scripts.torch_build).txt
	if $(BIN)/python -m scripts.torch_build --cuda; then $(LOCKED)/cuda.txt; fi
	$(BIN)/python -m pip check
	@touch $@

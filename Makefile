# What a developer calls; every step is skipped when nothing it reads has changed. `make help` lists the targets.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

PYTHON3 ?= python3
ISAS ?= v2;v3;v4
JOBS ?= $(shell nproc)
export CMAKE_BUILD_PARALLEL_LEVEL := $(JOBS)

VENV := .venv
BIN := $(VENV)/bin
STAMPS := build/stamps
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
EDITABLE := $(PIP) --no-build-isolation --no-deps --editable
CPP_FILES = $(shell find core tests/core -name '*.h' -o -name '*.cpp')
CORE_FILES := CMakeLists.txt core/pyproject.toml $(shell find core -name '*.h' -o -name '*.cpp')
PYTHON_DIRS := client server core/python tests

.PHONY: help
help: ## Say what there is
	@sed -nE 's/^([a-z-]+):.*## (.*)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 24

.PHONY: render
render: build ## Render the sample stage through the service to build/sample.exr and build/sample.png
	$(BIN)/footlight render examples/sample.usda -o build/sample.exr --png build/sample.png \
	    --size 960x540 --spp 256 --stats build/sample.json

.PHONY: test
test: lint types test-cpp test-python test-sanitized ## Everything that has to pass: lint, types, C++, Python, end to end, sanitizers

# --- the environment ---

.PHONY: setup
setup: $(STAMPS)/python ## Install Debian packages and the Python environment

$(STAMPS)/packages: packages.txt
	@mkdir -p $(@D)
	@missing=$$(while read -r name; do \
	    dpkg-query --show --showformat='$${db:Status-Status}\n' "$$name" 2>/dev/null | grep -qx installed || echo "$$name"; \
	done < packages.txt); \
	if [ -n "$$missing" ]; then \
	    echo "Installing" $$missing; \
	    sudo=$$([ "$$(id -u)" = 0 ] || echo sudo); \
	    $$sudo apt-get update --quiet=2; \
	    $$sudo env DEBIAN_FRONTEND=noninteractive apt-get install --quiet=2 --yes --no-install-recommends $$missing; \
	fi
	@touch $@

$(STAMPS)/python: requirements-dev.lock $(STAMPS)/packages
	@$(PYTHON3) -c 'import sys; sys.exit("Footlight needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	test -x $(BIN)/python || $(PYTHON3) -m venv $(VENV)
	$(PIP) --require-hashes --requirement requirements-dev.lock
	@touch $@

.PHONY: lock
lock: ## Choose versions anew and write both lock files
	$(PIP) uv
	for name in requirements requirements-dev; do \
	    $(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.11 --generate-hashes --no-annotate \
	        --no-header "$$name.in" --output-file "$$name.lock"; \
	done

# --- building ---

.PHONY: build
build: $(STAMPS)/core $(STAMPS)/client $(STAMPS)/server proto ## Build the core and install all three distributions, editable

.PHONY: proto
proto: $(STAMPS)/proto ## Generate the protobuf and gRPC code

$(STAMPS)/proto: $(shell find proto -name '*.proto') client/hatch_build.py $(STAMPS)/python
	$(BIN)/python client/hatch_build.py
	@touch $@

$(STAMPS)/core: $(CORE_FILES) $(STAMPS)/python
	@echo "Building the core for $(ISAS); the first time takes minutes"
	$(EDITABLE) core --config-settings=build-dir=$(CURDIR)/build/core \
	    "--config-settings=cmake.define.FOOTLIGHT_ISAS=$(ISAS)" --config-settings=cmake.define.FOOTLIGHT_TESTS=ON
	@touch $@

$(STAMPS)/client: client/pyproject.toml $(STAMPS)/proto
	$(EDITABLE) client
	@touch $@

$(STAMPS)/server: server/pyproject.toml $(STAMPS)/core $(STAMPS)/client
	$(EDITABLE) server
	@touch $@

# --- checking ---

.PHONY: lint
lint: $(STAMPS)/python ## Formatters and linters, nothing is changed
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	@echo clang-format-15 --dry-run --Werror …; clang-format-15 --dry-run --Werror $(CPP_FILES)
	$(BIN)/buf lint

.PHONY: format
format: $(STAMPS)/python ## Let the formatters change what they can
	$(BIN)/ruff format
	$(BIN)/ruff check --fix
	clang-format-15 -i $(CPP_FILES)
	$(BIN)/buf format --write

.PHONY: types
types: build ## mypy, strict
	$(BIN)/mypy $(PYTHON_DIRS)

.PHONY: test-cpp
test-cpp: build ## C++ tests, for every instruction set this machine runs
	cmake --build build/core --target core_tests
	ctest --test-dir build/core --output-on-failure

.PHONY: test-python
test-python: build ## Python tests, end to end included
	$(BIN)/pytest

.PHONY: test-sanitized
test-sanitized: $(STAMPS)/packages ## C++ tests under the address and undefined behaviour sanitizers
	cmake -S . -B build/sanitized -G Ninja -DCMAKE_BUILD_TYPE=Debug "-DCMAKE_CXX_FLAGS_DEBUG=-O1 -g1" -DFOOTLIGHT_ISAS=v3 \
	    -DFOOTLIGHT_SANITIZE=address,undefined -DFOOTLIGHT_MODULES=OFF -DFOOTLIGHT_TESTS=ON
	cmake --build build/sanitized --target core_tests
	ctest --test-dir build/sanitized --output-on-failure

.PHONY: mutants
mutants: $(STAMPS)/python ## Show that the laws reject wrong renderers; takes some minutes
	$(BIN)/python tests/mutants/run.py --jobs $(JOBS)

.PHONY: bench
bench: build ## Measure what the design promises and print a table
	$(BIN)/python tests/bench/bench.py

.PHONY: clean
clean: ## Remove what was built; the Python environment stays
	rm -rf build

# Ways in: make run, make test, make lint, make bench. Each sets up what it needs first.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

PYTHON_PACKAGES := proto services/sim services/control services/camera services/operator
VENV := .venv
BIN := $(VENV)/bin
UV := $(BIN)/uv pip install --quiet --system-certs --python $(BIN)/python
# TORCH=cpu takes torch's CPU build, a tenth of the default's size (uv knows where it is).
TORCH ?=
# Named after this folder: virtual environments and build trees do not survive being moved.
INSTALLED := $(VENV)/.installed-in$(subst /,-,$(CURDIR))
SOLVERS := services/control/armsight_control/solvers
PYTEST_ARGS ?=

.PHONY: help setup run test test-long lint format docs docs-serve docs-figures bench bench-vision bench-accuracy bench-ik bench-loop bench-robots bench-footprint bench-link bench-sessions lock clean vision system

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

setup: system $(INSTALLED) $(SOLVERS)/compiled/.made vision  ## install what is missing, build everything

system:
	@tools/check-toolchain.sh
	@tools/install-apt-packages.sh

$(BIN)/uv:
	python3 -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet uv

$(INSTALLED): requirements.txt $(PYTHON_PACKAGES:=/pyproject.toml) $(wildcard proto/armsight/v1/*.proto)
	@[ -f $@ ] || rm -rf $(VENV)
	@$(MAKE) $(BIN)/uv
	@echo "installing Python packages into $(VENV)"
	$(UV) $(if $(TORCH),--torch-backend $(TORCH)) -r requirements.txt
	$(UV) --no-deps --no-build-isolation --reinstall $(addprefix -e ,$(PYTHON_PACKAGES))
	@touch $@

# Nobody who solves then waits for a compiler.
$(SOLVERS)/compiled/.made: $(INSTALLED) $(addprefix $(SOLVERS)/,blocks.py compile.py packages.py ../torch_kinematics.py)
	@echo "compiling the solvers (some two minutes, the first time)"
	@$(BIN)/python -m armsight_control.solvers.compile
	@touch $@

vision: $(INSTALLED)
	@grep -qsx 'CMAKE_HOME_DIRECTORY:INTERNAL=$(CURDIR)/services/vision_cpp' build/vision/CMakeCache.txt || rm -f build/vision/{CMakeCache.txt,build.ninja}
	@[ -f build/vision/build.ninja ] || cmake -S services/vision_cpp -B build/vision -G Ninja -DCMAKE_BUILD_TYPE=Release
	@cmake --build build/vision

run: setup  ## run the full stack on this machine until Ctrl-C
	@exec $(BIN)/armsight up

test: setup  ## every test that fits into minutes
	tools/test.sh

test-long: setup  ## fuzz, fault and soak suites in full
	tools/fuzz.sh 300
	$(BIN)/pytest -m long --timeout 3600 $(PYTHON_PACKAGES) tests $(PYTEST_ARGS)

lint: setup  ## formatters, linters and type checkers, all of them
	tools/lint.sh

format: setup  ## rewrite everything the way lint wants it
	$(BIN)/ruff check --fix $(PYTHON_PACKAGES) tests bench tools docs examples
	$(BIN)/ruff format $(PYTHON_PACKAGES) tests bench tools docs examples
	git ls-files '*.cpp' '*.hpp' | xargs $(BIN)/clang-format -i
	cargo fmt --manifest-path services/vision_cpp/zenoh_bridge/Cargo.toml

# Material says at every build that it ends in May 2027; its successor, Zensical, reads the same mkdocs.yml.
docs: export NO_MKDOCS_2_WARNING := 1
docs: $(INSTALLED)  ## build the documentation's site into build/site; broken links fail
	@$(BIN)/mkdocs build --strict # not --quiet: it hides warnings from --strict as well

docs-serve: $(INSTALLED)  ## the same on http://127.0.0.1:8001, built anew at every change
	$(BIN)/mkdocs serve --dev-addr 127.0.0.1:8001

docs-figures: $(INSTALLED)  ## draw the figures of docs/explanation anew
	$(BIN)/python docs/figures/draw.py

bench: bench-vision bench-accuracy bench-ik bench-loop bench-robots bench-footprint bench-sessions  ## every benchmark; results in bench/results

bench-vision bench-accuracy bench-ik bench-loop bench-robots bench-footprint bench-link bench-sessions: setup
	$(BIN)/python bench/$(subst -,_,$(@:bench-%=%))_bench.py

# Our own packages are installed from their folders; what torch's default build brings for GPUs is left to torch, so that
# TORCH=cpu need not install it.
lock: $(BIN)/uv  ## pin the Python dependencies anew
	printf '%s\n' ./proto | cat requirements.in - >.lock.in
	$(BIN)/uv pip compile --system-certs --quiet --no-header --no-emit-index-url --no-annotate --python-version 3.11 \
	    --no-emit-package armsight .lock.in $(PYTHON_PACKAGES:=/pyproject.toml) \
	    | grep -vE '^(nvidia-|cuda-|triton|armsight)' >requirements.txt
	rm .lock.in

clean:  ## remove what setup and the tests made
	rm -rf $(VENV) build armsight-out $(SOLVERS)/compiled

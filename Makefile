# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
# `make demo` and `make test` need nothing done before; `make help` lists the rest.
#   PYTHON=python3.11   interpreter of the environment (default: the first suitable one)
#   ARGS='-k mill'      further arguments of pytest, of `fuzzycnc demo`, of the fault campaign, ...
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

VENV := $(CURDIR)/.venv
FLOOR := $(CURDIR)/.venv-floor
BIN := $(VENV)/bin
PYTHON ?=
ARGS ?=
FLOOR_TESTS := test/core test/simulation test/runtime test/components test/studies test/papers fuzzycnc_ros/core fuzzycnc_ros/simulation
# What browsers show is the same under any numpy; figures of papers rest on the arithmetic that
# `test/core` holds.
FLOOR_WITHOUT := --ignore=test/studies/test_reports_in_browser.py

# What a sourced ROS installation or another environment left behind would be mixed with ours.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH
unexport LD_LIBRARY_PATH PYTHONHOME PYTHONPATH VIRTUAL_ENV RMW_IMPLEMENTATION
# Without compiled modules on disk each of the many processes would compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE

# The environment is a whole ROS prefix; one thread a process, as two cores hold many processes.
ROS := AMENT_PREFIX_PATH='$(VENV)' OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

TESTS := $(ROS) '$(BIN)/python' tools/run_tests.py
PARALLEL := --timeout=600 -n auto --maxprocesses=8 --dist worksteal

.PHONY: help
help: ## List the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' Makefile

.PHONY: setup
setup: ## Build .venv: locked dependencies, messages, package (done once, as needed)
	@python=$$(tools/find_python.sh $(PYTHON)) && "$$python" tools/setup_env.py full

.PHONY: wheels
wheels: ## Write wheels of the package and its messages to dist/, to install without this tree
	@python=$$(tools/find_python.sh $(PYTHON)) && "$$python" tools/setup_env.py wheels

.PHONY: demo
demo: setup ## A thermal shift on the simulated mill: train, compensate live, report
	@$(ROS) '$(BIN)/fuzzycnc' demo $(ARGS)

.PHONY: test
test: lint ## Checks and the tests that a change can break, in minutes
	@$(TESTS) fast $(ARGS)

.PHONY: test-slow
test-slow: setup ## What `make test` leaves out: all seeds, full sizes, long replays
	@$(TESTS) slow $(ARGS)

.PHONY: test-all
test-all: test test-slow ## `make test` and `make test-slow`

.PHONY: qualify
qualify: setup ## Fault campaign, soak, LinuxCNC, many machines; wants an idle computer
	@$(TESTS) qualify $(ARGS)

.PHONY: faults
faults: setup ## The fault campaign with options, see ARGS=--help
	@$(ROS) '$(BIN)/python' test/qualification faults $(ARGS)

.PHONY: soak
soak: setup ## The soak with options, see ARGS=--help
	@$(ROS) '$(BIN)/python' test/qualification soak $(ARGS)

.PHONY: hal
hal: setup ## Build LinuxCNC's components into build/hal; needs halcompile
	@command -v halcompile >/dev/null || { echo 'hal: expected halcompile but found none; Debian: apt-get install linuxcnc-uspace-dev'; exit 1; }
	@rm -rf build/hal && mkdir -p build/hal && cp linuxcnc/*.comp linuxcnc/*.h build/hal
	@for kind in hal:fuzzycnc_axis_x plant:fuzzycnc_plant_x; do \
	  $(ROS) '$(BIN)/fuzzycnc' servo export --machine-file ballscrew --to $${kind%:*} --out build/hal/$${kind#*:}.comp; done
	@# one by one: halcompile keeps the options of a file for the next
	@cd build/hal && for file in *.comp; do halcompile --compile $$file || exit 1; done

.PHONY: bench
bench: setup ## One table: speed beside libraries that do the same work; wants an idle computer
	@$(ROS) '$(BIN)/python' benchmarks/performance.py

.PHONY: lint
lint: setup ## Style, format, spelling, types
	@echo 'ruff check' && '$(BIN)/ruff' check --quiet .
	@echo 'ruff format' && '$(BIN)/ruff' format --quiet --check . || { '$(BIN)/ruff' format --check .; exit 1; }
	@echo 'codespell' && '$(BIN)/codespell'
	@echo 'mypy' && '$(BIN)/mypy'

.PHONY: format
format: setup ## Rewrite the sources in the project's format
	@'$(BIN)/ruff' check --quiet --fix . ; '$(BIN)/ruff' format .

.PHONY: tables
tables: setup ## Write the generated tables of the docs and params/*.yaml anew
	@'$(BIN)/python' tools/make_tables.py

.PHONY: pictures
pictures: setup ## Draw the pictures of README and docs anew, from runs of the simulated machines
	@$(ROS) '$(BIN)/python' tools/make_pictures.py $(ARGS)

.PHONY: examples
examples: setup ## Write the recordings and part programs of examples/ anew
	@$(ROS) '$(BIN)/python' tools/make_examples.py $(ARGS)

.PHONY: docs
docs: setup ## Build the site into build/docs/html; warnings and dead links are errors
	@'$(BIN)/uv' pip install --quiet --python '$(BIN)/python' --no-deps --require-hashes \
	  --requirement requirements/docs.txt
	@$(ROS) '$(BIN)/python' tools/make_docs.py $(ARGS)

.PHONY: test-floor
test-floor: ## Core and components without ROS on Ubuntu 24.04's versions (Python 3.12)
	@python=$$(tools/find_python.sh $(or $(PYTHON),python3.12)) && \
	  "$$python" -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if v == (3, 12) else f"test-floor: expected Python 3.12 but found {v[0]}.{v[1]}")' && \
	  "$$python" tools/setup_env.py floor
	@PYTHONPATH='$(CURDIR)' OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 '$(FLOOR)/bin/python' -m pytest \
	  $(PARALLEL) -m 'not ros and not slow and not qualify and not paper' \
	  -p no:cacheprovider $(FLOOR_TESTS) $(FLOOR_WITHOUT) $(ARGS)

.PHONY: lock
lock: ## Resolve requirements/*.in anew (ARGS=--upgrade for the newest)
	@PATH='$(BIN)':"$$PATH" tools/lock.sh $(ARGS)

.PHONY: clean
clean: ## Remove the environments and everything built
	@rm -rf .venv .venv-floor build dist install log *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -not -path './.git/*' -type d -prune -exec rm -rf {} +

# Each target sets up what it needs: python3 (>= 3.11) and make are enough.
PYTHON ?= python3
BIN := .venv/bin
ARGS ?=

.PHONY: help demo test test-all test-no-clock test-clock test-kernel test-ros test-lerobot check docs bench bench-diagnosis pictures clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-15s %s\n", $$1, $$2}'

demo: .venv/run.done  ## a whole session on a simulated rig: make demo ARGS="--duration 30 --view none"
	@$(BIN)/teleop run --config configs/demo.yaml $(ARGS)

# without a clock; waiting on one, side by side, too; limits in milliseconds, alone (tests/conftest.py).
# a busy machine can hold anything up: a test that waits fails if it does so twice in a row, one
# with a clock if it does so three times, but gates and sessions at once (tests/conftest.py); what was
# run again is counted in the last line
QUICK = and not slow
test-all: QUICK :=
test test-all: test-no-clock test-clock
test-no-clock test-clock: export PYTHONDONTWRITEBYTECODE :=  # hundreds of processes import the same modules
test-no-clock test-clock: export OPENBLAS_NUM_THREADS := 1
test-no-clock: .venv/dev.done
	@$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder --reruns 1 -m "not real_time $(QUICK)" $(ARGS) || [ $$? = 5 ]
test-clock: .venv/dev.done
	@$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder --reruns 2 -m "real_time and not alone $(QUICK)" $(ARGS) || [ $$? = 5 ]
	@$(BIN)/python -m pytest --reruns 2 -m "alone $(QUICK)" $(ARGS) || [ $$? = 5 ]
test:  ## the tests, slow matrices apart; ARGS goes to pytest
test-all:  ## all tests
.NOTPARALLEL:  # tests with a clock come after the others

test-kernel: .venv/dev.done  ## HID and CAN drivers on virtual devices, through a Linux kernel in qemu; ARGS: devices, or can
	@$(BIN)/python -m studies.kernel $(ARGS)

test-ros: .cache/ros/done  ## messages, hashes and graph against rclpy and other implementations of ROS 2
	@.cache/ros/bin/python -m pytest tests/teleop/ros/test_peers.py $(ARGS)

test-lerobot: .venv/dev.done .cache/lerobot/done  ## datasets for learning, against the reader of LeRobot (installs 8 GB)
	@$(BIN)/python -m pytest tests/teleop/data/test_lerobot.py $(ARGS)

check: .venv/dev.done  ## format, lint, types, import rules
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: .venv/docs.done  ## the documentation as a site, links checked: .cache/site/index.html
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build
	@echo "written: .cache/site/index.html"

bench: .venv/dev.done  ## speed and noise figures, each beside a baseline of the same run; more: studies/README.md
	@for name in estimator_speed noise_treatment plant recording tracking impair memory authentication router_scale; do \
		echo "== $$name"; $(BIN)/python -m studies.$$name || exit 1; done

bench-diagnosis: .venv/dev.done  ## hide effects, diagnose, count what is found (hours); ARGS as in --help
	@$(BIN)/python -m studies.hidden_effects.campaign $(ARGS)

pictures: .venv/dev.done  ## the pictures of the live view in docs/images, from real runs (needs Chromium)
	@$(BIN)/python -m docs.pictures

clean:  ## remove the environment and everything made by running
	rm -rf .venv .cache build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.12 ...")'
	@$(PYTHON) -m venv .venv || { echo "No venv module: install it (Debian: apt-get install python3-venv)"; rm -rf .venv; exit 1; }

.venv/run.done: .venv/bin/python pyproject.toml
	@echo "Setting up .venv (once) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

.venv/dev.done: .venv/bin/python pyproject.toml
	@echo "Setting up .venv, with the tools for tests and checks (once) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch .venv/run.done $@

.cache/ros/done: .venv/bin/python pyproject.toml  # apart: rclpy brings packages of common names
	@echo "Setting up .cache/ros with ROS 2 for Python (once) ..."
	@$(PYTHON) -m venv .cache/ros
	@.cache/ros/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[dev,ros-peers]'
	@touch $@

.cache/lerobot/done: .venv/bin/python  # apart: LeRobot needs another version of Rerun
	@echo "Setting up .cache/lerobot with LeRobot (once) ..."
	@$(PYTHON) -m venv .cache/lerobot
	@.cache/lerobot/bin/python -m pip install --quiet --disable-pip-version-check 'lerobot[dataset]>=0.4'
	@touch $@

.venv/docs.done: .venv/dev.done
	@echo "Adding the tools for the documentation (once) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@

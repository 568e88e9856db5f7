# Finger contact suite. `make demo` and `make test` set up everything they need.
PYTHON ?= python3
ENV := .venv
RUN := $(ENV)/bin/python
export OMP_NUM_THREADS ?= 1
# Containers often set it; then every process compiles the sources again.
unexport PYTHONDONTWRITEBYTECODE
# One worker more than cores: many tests wait for nodes, devices and browsers.
WORKERS ?= $(shell echo $$(($$(nproc) + 1)))

define check_python
@command -v $(PYTHON) >/dev/null || { echo "setup: $(PYTHON) not found:" \
  "install Python 3.10 to 3.13 or name one with PYTHON=…" >&2; exit 2; }
endef

.PHONY: help setup setup-test demo test test-slow test-compat lint bench soak faults bags \
  reference clean

help:
	@echo "make demo         set up, run the simulated rig, record, fit, write out/demo/report.html"
	@echo "make test         set up and run the tests (test-slow: the long ones)"
	@echo "make lint         check style and types, as make test does first"
	@echo "make test-compat  the core tests with NumPy 1.26 and OpenCV 4, as on apt Jazzy"
	@echo "make bench        measure the key figures into bench/results.json"
	@echo "make soak         record the full rig load for 30 minutes"
	@echo "make faults       provoke all faults, 30 minutes of them at random; write docs/faults.md"
	@echo "make bags         make the sample bags again"
	@echo "make reference    write docs/nodes.md, rig.yaml and the packages' release files"
	@echo "make setup        only set up the environment in $(ENV)"
	@echo "make clean        remove what demo, tests and colcon wrote"

setup:
	$(check_python)
	@$(PYTHON) scripts/setup_env.py --env $(ENV)

setup-test:
	$(check_python)
	@$(PYTHON) scripts/setup_env.py --env $(ENV) --test

demo: setup
	@$(RUN) examples/demo -o out/demo

lint: setup-test
	@$(RUN) -m ruff check .
	@$(RUN) -m ruff format --check .
	@$(RUN) scripts/type_check.py

test: lint
	@$(RUN) -m pytest -n $(WORKERS) --dist loadfile -m "not slow and not alone"
	@$(RUN) -m pytest -m "alone and not slow"

test-slow: setup-test
	@$(RUN) -m pytest -m slow

test-compat:
	@$(PYTHON) scripts/test_compat.py

bench: setup
	@$(RUN) bench/run.py

faults: setup-test
	@$(RUN) scripts/faults.py --measure
	@$(RUN) tests/fuzz --cases 20000 --seed 2 --few --record --keep out/fuzz
	@$(RUN) scripts/random_faults.py --minutes 30 --record

soak: setup
	@$(RUN) scripts/soak.py

bags: setup
	@$(RUN) examples/sample_bags.py

reference: setup
	@$(RUN) scripts/node_reference.py
	@$(RUN) scripts/release_files.py

clean:
	rm -rf out build install log .pytest_cache .ruff_cache .mypy_cache

# Two commands do all the set-up on a fresh machine: `make run` (the main job) and `make test`.
# Each creates .venv with what it needs; only the tests need PyTorch. One that is in .venv is kept, so
# to avoid the CUDA build on a machine without a GPU, install PyTorch's CPU build there first.

PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --constraint constraints.txt
PROBLEM ?= cartpole-length
PYTEST = $(BIN)/python -m pytest --numprocesses auto --dist worksteal --durations 25

.PHONY: run test test-long lint format bench pictures clean

run: .venv/run.stamp
	$(BIN)/mbtl run $(PROBLEM)

test: .venv/dev.stamp
	$(PYTEST) -m "not long" $(TESTS)

# real trainings, sweeps of kills, parity with SUMO: before an issue that touches them is resolved
test-long: .venv/dev.stamp
	$(PYTEST) -m long $(TESTS)

lint: .venv/dev.stamp
	$(BIN)/ruff check src tests benchmarks examples
	$(BIN)/ruff format --check src tests benchmarks examples
	$(BIN)/mypy

format: .venv/dev.stamp
	$(BIN)/ruff check --fix src tests benchmarks examples
	$(BIN)/ruff format src tests benchmarks examples

bench: .venv/rivals.stamp
	$(BIN)/python benchmarks/import_time.py
	$(BIN)/python benchmarks/pick_latency.py
	$(BIN)/python benchmarks/million_contexts.py
	$(BIN)/python benchmarks/bench_six.py
	$(BIN)/python benchmarks/gp_optimum.py
	$(BIN)/python benchmarks/env_speed.py
	$(BIN)/python benchmarks/jax_throughput.py
	$(BIN)/python benchmarks/jax_evaluation.py

# the pictures of README and of the page of the reproduction, and that page, from shipped matrices
pictures: .venv/run.stamp
	$(BIN)/mbtl reproduce --page docs/reproduction.md

clean:
	rm -rf .venv build .mypy_cache .ruff_cache .pytest_cache

.venv/bin/python:
	$(PYTHON) -m venv .venv

.venv/run.stamp: .venv/bin/python pyproject.toml constraints.txt
	$(PIP) --editable '.[jax,plots]'
	touch $@

# torch alone first: asked for together with others, pip may prefer another build of it
.venv/dev.stamp: .venv/run.stamp
	$(PIP) torch
	$(PIP) --editable '.[jax,plots,train,traffic,envs,cluster,dev]'
	touch $@

.venv/rivals.stamp: .venv/dev.stamp
	$(PIP) --editable '.[jax,plots,train,traffic,envs,cluster,dev,rivals]'
	touch $@

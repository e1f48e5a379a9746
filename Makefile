# Two commands do all the set-up on a fresh machine: `make run` (the main job) and `make test`.
# Each creates .venv with what it needs, by uv where it can be had and by pip otherwise. Only the tests
# need PyTorch; its CPU build is taken where one can be reached, and one that is in .venv is kept.

# what was compiled is kept in .venv and beside the sources: every start is a second faster
unexport PYTHONDONTWRITEBYTECODE

PYTHON ?= python3
BIN := .venv/bin
PIP := tools/install
PROBLEM ?= pendulum-mass
BRIEF := --preset quick --timesteps 300000 --eval-episodes 10 --budget 4
FIRST := runs/first
PYTEST = $(BIN)/python -m pytest --numprocesses logical --dist worksteal --durations 25

.PHONY: run test test-long lint format docs bench release-check pictures films clean

# the paper's rule and the default, at a time; a page shows both
run: .venv/run.stamp
	mkdir -p $(FIRST)
	$(BIN)/mbtl run $(PROBLEM) $(BRIEF) --strategy auto --study $(FIRST)/auto > $(FIRST)/auto.log 2>&1 & \
	$(BIN)/mbtl run $(PROBLEM) $(BRIEF) --strategy mbtl --study $(FIRST)/mbtl; one=$$?; \
	wait $$!; other=$$?; cat $(FIRST)/auto.log; exit $$((one + other))
	$(BIN)/mbtl report $(FIRST)/mbtl $(FIRST)/auto --out $(FIRST)/report.html

# compiling is most of what tests with jax do: without its passes it takes a third of the time
test: export XLA_FLAGS ?= --xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false
test: .venv/dev.stamp
	$(PYTEST) -m "not long" $(TESTS)

# real trainings, sweeps of kills, parity with SUMO: before an issue that touches them is resolved
test-long: .venv/dev.stamp
	$(PYTEST) -m long $(TESTS)

lint: .venv/dev.stamp
	$(BIN)/ruff check src tests benchmarks evidence examples tools docs/conf.py docs/notebooks
	$(BIN)/ruff format --check src tests benchmarks evidence examples tools docs/conf.py docs/notebooks
	$(BIN)/mypy

format: .venv/dev.stamp
	$(BIN)/ruff check --fix src tests benchmarks evidence examples tools docs/conf.py docs/notebooks
	$(BIN)/ruff format src tests benchmarks evidence examples tools docs/conf.py docs/notebooks

# the site, in build/site; a warning is an error, also of a page that did not change
docs: .venv/docs.stamp
	$(BIN)/sphinx-build -E -W --keep-going -q -b html docs build/site

bench: .venv/rivals.stamp
	$(BIN)/python benchmarks/import_time.py
	$(BIN)/python benchmarks/pick_latency.py
	$(BIN)/python benchmarks/million_contexts.py
	$(BIN)/python benchmarks/bench_six.py
	$(BIN)/python benchmarks/gp_optimum.py
	$(BIN)/python benchmarks/env_speed.py
	$(BIN)/python benchmarks/jax_throughput.py
	$(BIN)/python benchmarks/jax_evaluation.py

# wheel and sdist, used in clean environments of every Python, with the newest and oldest dependencies
release-check: .venv/run.stamp
	$(BIN)/python tools/release_check.py

# the pictures of README, of concepts and the reproduction, with the page of the last; from shipped matrices
pictures: .venv/run.stamp
	$(BIN)/mbtl reproduce --page docs/reproduction.md
	$(BIN)/python evidence/pictures.py --write

# the films and film strips of docs, of policies kept in runs/ (evidence/films.py says by which commands)
films: .venv/dev.stamp
	$(BIN)/python evidence/films.py --write
	$(BIN)/python evidence/catalogue.py --films --write

clean:
	rm -rf .venv build dist .mypy_cache .ruff_cache .pytest_cache

.venv/bin/python:
	$(PYTHON) -m pip --version > /dev/null && $(PYTHON) -m venv --without-pip .venv || $(PYTHON) -m venv .venv

.venv/run.stamp: .venv/bin/python pyproject.toml constraints.txt tools/install
	$(PIP) --editable '.[jax,plots]'
	touch $@

# torch alone first: asked for together with others, another build of it may be preferred
.venv/dev.stamp: .venv/run.stamp
	$(PIP) torch
	$(PIP) --editable '.[jax,plots,train,traffic,envs,cluster,dev]'
	touch $@

.venv/docs.stamp: .venv/dev.stamp
	$(PIP) --editable '.[jax,plots,train,traffic,envs,cluster,dev,docs]'
	touch $@

.venv/rivals.stamp: .venv/dev.stamp
	$(PIP) --editable '.[jax,plots,train,traffic,envs,cluster,dev,rivals]'
	touch $@

# The same commands at home and in CI. Only Python 3.11+ and pip are needed: every target sets up what it uses.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
OUT    ?= out

.PHONY: demo test test-slow test-models durations check bench bench-agents certify docs clean

demo: $(VENV)/.core
	$(BIN)/f3sr demo -o $(OUT)/demo --overwrite

test: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

# What takes seconds each: whole commands, kills, memory, every example of the documents.
test-slow: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist worksteal -m slow

# Networks with random weights: torch is large, and only these tests need it. This version is the build for CPUs.
test-models: $(VENV)/.models
	$(BIN)/python -m pytest tests/test_neural.py tests/test_model_source.py tests/test_fitted_depth.py tests/test_normal_maps.py

durations: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist worksteal --junitxml=$(OUT)/tests.xml
	$(BIN)/python benchmarks/durations.py $(OUT)/tests.xml > $(OUT)/test_durations.md
	mv $(OUT)/test_durations.md docs/test_durations.md

check: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

bench: $(VENV)/.dev
	$(BIN)/python benchmarks/run.py
	$(BIN)/python benchmarks/alignment.py
	$(BIN)/python benchmarks/stress.py --containers
	$(BIN)/python benchmarks/goals/run.py
	$(BIN)/python benchmarks/film.py
	$(BIN)/python benchmarks/rendering.py --packages out/bench

# Models through roles and one direct call; MODEL=openai:NAME asks a real one.
bench-agents: $(VENV)/.dev
	$(BIN)/python benchmarks/goals/agents.py $(addprefix --model ,$(MODEL))

# The example in other people's engines and validators, each group in an environment of its own. MJX is left out: it
# does not compile scenes of many hulls. Khronos' validator comes with npm, not with pip.
ENGINES    := build/certify
CLIENTS    := mujoco,mujoco-warp,newton,pybullet,drake,sapien,simready,usd,mjcf-doctor
IN_CLASSIC := pybullet drake mjcf-doctor
IN_WARP    := mujoco-warp newton
certify: $(VENV)/.usd $(ENGINES)/classic/.done $(ENGINES)/warp/.done $(ENGINES)/sapien/.done $(ENGINES)/simready/.done
	$(BIN)/f3sr reconstruct src/f3sr/example/tabletop -o $(OUT)/certified
	$(BIN)/f3sr certify $(OUT)/certified -o $(OUT)/certificate --overwrite --engines $(CLIENTS) --deadline 1800 \
		$(foreach name,$(IN_CLASSIC),--python $(name)=$(ENGINES)/classic/bin/python) \
		$(foreach name,$(IN_WARP),--python $(name)=$(ENGINES)/warp/bin/python) \
		--python sapien=$(ENGINES)/sapien/bin/python --python simready=$(ENGINES)/simready/bin/python

docs: $(VENV)/.docs
	$(BIN)/mkdocs build --strict

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.core: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install -q -e .
	@touch $@

$(VENV)/.dev: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install -q -e ".[dev]"
	@touch $@ $(VENV)/.core

$(VENV)/.usd: pyproject.toml | $(VENV)/.core
	$(BIN)/python -m pip install -q -e ".[usd]"
	@touch $@

$(ENGINES)/classic/.done: PACKAGES := mujoco pybullet drake mjcf-doctor
$(ENGINES)/warp/.done: PACKAGES := "newton[sim]" pillow trimesh
$(ENGINES)/sapien/.done: PACKAGES := sapien==3.0.3
$(ENGINES)/simready/.done: PACKAGES := simready-validate simready-foundation-tier-core
$(ENGINES)/%/.done:
	$(PYTHON) -m venv $(ENGINES)/$*
	$(ENGINES)/$*/bin/python -m pip install -q $(PACKAGES)
	@touch $@

$(VENV)/.models: pyproject.toml | $(VENV)/.dev
	$(BIN)/python -m pip install -q torch==2.13.0
	$(BIN)/python -m pip install -q --no-deps torchvision==0.28.0  # the oracle of three processors; beside another torch it needs CUDA
	$(BIN)/python -m pip install -q -e ".[dev,models]"
	@touch $@

$(VENV)/.docs: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install -q -e ".[docs]"
	@touch $@

clean:
	rm -rf $(OUT) site build dist

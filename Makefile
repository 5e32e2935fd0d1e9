# make demo   watch an information-gain planner beat a random one (needs Rust, Python >= 3.10 and a C compiler)
# make test   everything that continuous integration runs
# make bench  speed of every stage, and of the peers that are installed
# make instructions  compare the hot loops' instruction counts with the baseline (RENEW=1 writes a new one)
# make docs   build the documentation into docs/_build
# make clean  remove everything that was built

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/demo
SOURCES := $(shell find rust_env/src -name '*.rs') Cargo.toml Cargo.lock pyproject.toml
# uv is much quicker than pip and keeps a cache.
INSTALL := $(BIN)/python -m uv pip install --python $(BIN)/python
MYPY_TARGETS := -p nbv_gym.rust_env -p nbv_gym.envs -p nbv_gym.agents -p nbv_gym.training

.DEFAULT_GOAL := help
.PHONY: help demo test lint types rust python bench instructions docs clean toolchain

help:
	@sed -n 's/^# //p' Makefile | head -n 6

toolchain:
	@command -v cargo >/dev/null || { echo "nbv-gym needs Rust: install it from https://rustup.rs, then run make again."; exit 1; }
	@command -v cc >/dev/null || { echo "nbv-gym needs a C compiler (Debian: apt install build-essential; macOS: xcode-select --install)."; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null || { echo "nbv-gym needs Python 3.10 or newer; say which with make PYTHON=/path/to/python3."; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "This Python lacks venv (Debian: apt install python3-venv)."; exit 1; }

$(VENV)/.created: | toolchain
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	touch $@

# The light core, for users.
$(VENV)/.core: $(VENV)/.created $(SOURCES)
	$(INSTALL) --quiet --editable .
	touch $@

# The same and all that tests need.
$(VENV)/.test: $(VENV)/.created $(SOURCES)
	$(INSTALL) --quiet --editable '.[test,train,dev]'
	touch $@ $(VENV)/.core

demo: toolchain $(VENV)/.core
	$(BIN)/nbv-gym demo --out $(OUT)

test: toolchain lint rust python types

lint: $(VENV)/.test
	cargo fmt --check
	cargo clippy --release --all-targets -- -D warnings
	cargo clippy --release --features python -- -D warnings
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

rust: toolchain
	cargo test --release

python: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 -rs

# Type checkers do not follow editable installs; they find the package by a link to this folder.
types: $(VENV)/.test
	@mkdir -p build/types && ln -sfn ../.. build/types/nbv_gym
	$(BIN)/mypy $(MYPY_TARGETS)
	$(BIN)/python -m mypy.stubtest nbv_gym.rust_env.nbv_core --ignore-missing-stub

bench: $(VENV)/.test
	$(INSTALL) --quiet --editable '.[bench]'
	$(BIN)/nbv-gym bench

# Part of `make test`, too, by way of pytest.
instructions: $(VENV)/.test
	NBV_GYM_RENEW_INSTRUCTIONS=$(RENEW) $(BIN)/python -m pytest -rs tests/test_instructions.py

docs: $(VENV)/.test
	$(INSTALL) --quiet --editable '.[docs]'
	$(BIN)/sphinx-build -W -b html docs docs/_build

clean:
	rm -rf $(VENV) target build dist out *.egg-info docs/_build rust_env/*.so

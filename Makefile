# Two commands for a newcomer: `make demo` and `make test`.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip --disable-pip-version-check --quiet
# this PyTorch has no CUDA libraries where the index offers a CPU build
TORCH  := torch==2.13.0

.PHONY: demo test lint format browser clean

demo: $(VENV)/.robot
	$(BIN)/gatar sim --team 3A3G --targets 24 --size 15 --seed 1 --out runs/$$(date +%Y%m%d-%H%M%S)

test: $(VENV)/.test browser lint
	$(BIN)/python -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m mypy
	$(BIN)/lint-imports

format: $(VENV)/.test
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# the browser tests drive Debian's Chromium; where it may not be installed they skip, and say so
browser:
	@command -v chromium >/dev/null && command -v chromedriver >/dev/null \
	  || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
	       && apt-get update -qq && apt-get install -y -qq chromium chromium-driver >/dev/null; } \
	  || echo "make: no Chromium and no leave to install it: the browser tests will be skipped"

# Debian keeps venv in a package of its own
$(VENV)/bin/python:
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null \
	  || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
	       && apt-get update -qq && apt-get install -y -qq python3-venv >/dev/null; } \
	  || { echo "make: $(PYTHON) has no venv: apt-get install python3-venv"; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.robot: $(VENV)/bin/python pyproject.toml constraints.txt
	@echo "installing the robot runtime into $(VENV) (no torch) ..."
	$(PIP) install -c constraints.txt -e .
	@touch $@

$(VENV)/.test: $(VENV)/bin/python pyproject.toml constraints.txt
	@echo "installing everything that the tests need into $(VENV) ..."
	$(PIP) install $(TORCH) -c constraints.txt
	$(PIP) install -c constraints.txt -e '.[test]'
	@touch $@ $(VENV)/.robot

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

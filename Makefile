# Two commands need nothing but Python and make: `make demo` and `make test`.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
DEV    := $(VENV)/.installed-dev
OTHER  := $(VENV)/other
PEERS  := $(VENV)/bench
TORCH  := $(VENV)/bench-torch

# the tests start palpate some hundred times; each would compile all of it
unexport PYTHONDONTWRITEBYTECODE

# distributions of their own, and their packages; what that of lerobot needs is too large to be installed for tests
PLUGINS  := $(filter-out plugins/lerobot,$(wildcard plugins/*))
PACKAGES := $(notdir $(patsubst %/__init__.py,%,$(wildcard plugins/*/src/*/__init__.py)))
REALTIME = $(shell grep --recursive --files-with-matches mark.realtime tests plugins)

.PHONY: help demo test tests realtime lint types layers check firmware docs wheel campaign bench bench-torch clean

help:
	@echo "make demo      identify a part on the emulated bench (installs what it needs first)"
	@echo "make test      every check: lint, types, layers, tests"
	@echo "make firmware  the C firmware for arrays, on this computer, and what its tests need"
	@echo "make docs      the documentation of this version, in build/docs, beside that of others"
	@echo "make wheel     sdist and wheels in dist/, compiled and pure, as an index takes them"
	@echo "make campaign  the tests with all their cases and the long seeded benchmarks, with their tables"
	@echo "make bench     palpate beside its peers and how cost grows: writes the tables of docs/performance.md"
	@echo "make bench-torch  installs the peers that need PyTorch (7 GB) for make bench"
	@echo "make clean     remove what the above made"

$(STAMP): pyproject.toml $(PLUGINS:=/pyproject.toml)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable . $(PLUGINS:%=--editable %)
	@touch $@

# without bytecode of what no test imports
$(DEV): pyproject.toml $(PLUGINS:=/pyproject.toml)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable '.[dev]' $(PLUGINS:%=--editable %)
# the vendor's SDK as most programs still have it, a client in tests: it cannot be installed beside the one we use
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --upgrade \
		--target $(OTHER)/dynamixel-sdk-3.8.4 dynamixel-sdk==3.8.4
# what hands and arms of others drive servos with, clients in tests: their buses alone, on the SDK that they pin
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --upgrade \
		--target $(OTHER)/lerobot lerobot==0.4.4 "deepdiff>=8,<9" "orderly-set<6" tqdm dynamixel-sdk==3.8.4
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --upgrade \
		--target $(OTHER)/orca_core orca-core==0.12.0 pyyaml dynamixel-sdk==3.8.4
	@touch $(STAMP) $@

demo: $(STAMP)
	$(BIN)/palpate identify --seed 19 --picture demo.svg

lint: $(DEV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(DEV)
	$(BIN)/mypy -p palpate $(PACKAGES:%=-p %)

layers: $(DEV)
	$(BIN)/lint-imports

check: lint types layers

# needs a C compiler
firmware:
	$(MAKE) -C firmware

# all at once: tests in real time mostly wait
test: $(DEV)
	$(MAKE) --jobs 3 check tests realtime

# a process a core: more threads for small matrices only stand in each other's way
tests: $(DEV) firmware
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n auto --dist worksteal --durations 40 -m "not realtime and not campaign"

# four at a time, each a client and an emulator in real time; printed at the end, not between the others
realtime: $(DEV) firmware
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n 4 --dist worksteal -m "realtime and not campaign" $(REALTIME) \
		> $(VENV)/realtime.txt 2>&1; ended=$$?; cat $(VENV)/realtime.txt; exit $$ended

# the site, where every warning is an error
docs: $(DEV)
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet --builder html docs \
		build/docs/$$($(BIN)/python -c "from importlib.metadata import version; print(version('palpate'))")
	@echo "build/docs/index.html"

# the compiled wheel holds for this and newer Pythons, and for systems at least as old as auditwheel says
wheel: $(DEV)
	rm -rf dist build/lib* build/temp* build/bdist* src/palpate.egg-info
	$(BIN)/python -m build --no-isolation --sdist
	PALPATE_WHEEL=stable $(BIN)/python -m build --no-isolation --wheel --outdir build/bdist
	$(BIN)/auditwheel show build/bdist/*.whl
	PATH=$(BIN):$$PATH $(BIN)/auditwheel repair --wheel-dir dist build/bdist/*.whl
	rm -rf build/lib* build/bdist*
	PALPATE_WHEEL=pure $(BIN)/python -m build --no-isolation --wheel
	$(BIN)/twine check --strict dist/*

campaign: $(DEV)
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n auto --dist worksteal -m "campaign and not realtime"
	$(BIN)/pytest -m "campaign and realtime"
	$(BIN)/python benchmarks/bench_completeness.py
	$(BIN)/python benchmarks/bench_recognizer.py
	$(BIN)/python benchmarks/bench_identify.py
	$(BIN)/python benchmarks/bench_firmware.py
# exit code 2: the packages of the emulated boards are missing, and it has said which
	$(BIN)/python benchmarks/bench_firmware_qemu.py --frames 100000 --parts 10 || [ $$? = 2 ]

$(PEERS)/.installed: benchmarks/requirements.txt
	$(PYTHON) benchmarks/install_peers.py $< $(PEERS)

$(TORCH)/.installed: benchmarks/requirements-torch.txt
	$(PYTHON) benchmarks/install_peers.py $< $(TORCH)

bench-torch: $(TORCH)/.installed

# on one core; what is not installed is named as skipped
bench: $(DEV) $(PEERS)/.installed
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_peers.py --write \
		--python $(PEERS)/bin/python --torch-python $(TORCH)/bin/python
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_servo_peers.py --write \
		--python $(PEERS)/bin/python --torch-python $(TORCH)/bin/python
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_import_peer.py --write
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_emulation.py --time --write
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_waiting.py --write
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_growth.py --write
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_peers.py --compare

clean:
	$(MAKE) -C firmware clean
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

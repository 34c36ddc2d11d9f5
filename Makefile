# make demo: install, make the demo archive, process it.  make test: install, run all tests.
PYTHON ?= python3
CORES ?= 2
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
LOCK := workflow/envs/requirements.lock

.DEFAULT_GOAL := help
.PHONY: help setup demo slurm browser test test-faults test-repro test-slurm bench-integration bench-laser \
  bench-photometry bench-speed bench-plan bench-full lint format lock clean

help: ## Say what each target does
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12

setup: $(READY) ## Install everything into .venv

$(READY): $(LOCK) pyproject.toml workflow/envs/debian-packages.txt workflow/envs/system-libraries.sh
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "Treadlight needs Python 3.11 or newer: make PYTHON=/path/to/python3.11"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes --prefer-binary -r $(LOCK)
	$(BIN)/python -m pip check --quiet
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	sh workflow/envs/system-libraries.sh $(BIN)/python
	touch $@

demo: setup ## Make the demo archive (once), process it, say where the result page is
	$(BIN)/treadlight simulate demo/archive --preset demo
	$(BIN)/snakemake --cores $(CORES)
	@echo "Result page: results/index.html"

slurm: setup ## Install what jobs need to run in a Slurm queue
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r workflow/envs/slurm.lock

browser: ## Install Chromium for the tests of the pages, where that is allowed
	@sh workflow/envs/browser.sh

test: setup browser ## Run all tests, with coverage
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python -m pytest -n $(CORES) --dist loadfile --no-loadscope-reorder --cov --cov-report=term --cov-fail-under=85 --durations=25

test-faults: setup ## Kills, damaged inputs and corrupt results by the hundred (long)
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python tests/faults/run.py --jobs $(CORES)

test-repro: setup ## Two fresh clones, on one core and on two, give the same digests
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python tests/faults/repro.py

test-slurm: slurm ## A small archive through a Slurm queue on this machine, bit for bit as without
	sh workflow/envs/slurm.sh
	$(BIN)/python tests/slurm/run.py --cores $(CORES)

bench-laser: setup ## The laser line's detector beside four others (figures in build/)
	$(BIN)/python tests/benchmarks/laser/study.py --shared ../shared --out build/bench-laser

bench-integration: setup ## Poisson, the dissertation's and bilateral integration beside ours (figures in build/)
	$(BIN)/snakemake --cores $(CORES) --quiet rules --config archive=../shared/captures/sample results=build/sample
	$(BIN)/python tests/benchmarks/integration/study.py build/sample ../shared --out build/bench-integration

bench-photometry: setup ## Every estimator of normals on renders, photographs and a tire (figures in build/)
	sh tests/benchmarks/photometry/povray.sh
	$(BIN)/snakemake --snakefile tests/benchmarks/photometry/Snakefile --cores $(CORES) --quiet rules
	@cat build/bench-photometry/summary.md build/bench-photometry/figures.json

bench-speed: setup ## How fast kernels are, beside plain versions, and stages, over sizes (renders them; long)
	NUMBA_NUM_THREADS=2 OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/speed_photometry.py
	$(BIN)/snakemake --cores $(CORES) --quiet rules --config archive=../shared/captures/sample results=build/sample
	$(BIN)/python tests/benchmarks/speed_multigrid.py ../shared/captures/sample/t7-00100 \
	  build/sample/captures/t7-00100 build/sample/calibrations/bench-1-2020-01/calibration.json
	$(BIN)/python tests/benchmarks/full/scaling.py

bench-plan: setup ## Plan an archive of 1,000 captures: time, memory, what is added, what fails (long)
	$(BIN)/python tests/benchmarks/plan/study.py

bench-full: setup ## A sector at full size through every stage; renders it first (8 GB in build/; long)
	$(BIN)/python tests/benchmarks/full/study.py --cores $(CORES)

lint: setup ## Check style, types and layers
	$(BIN)/ruff check . && $(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/snakefmt --check Snakefile rules tests/benchmarks
	$(BIN)/lint-imports

format: setup ## Format Python and Snakemake files
	$(BIN)/ruff check --fix . && $(BIN)/ruff format . && $(BIN)/snakefmt Snakefile rules tests/benchmarks

lock: ## Pin the newest versions (needs pip-tools)
	pip-compile --quiet --generate-hashes --allow-unsafe --strip-extras --no-emit-options \
	  --no-header --output-file $(LOCK) workflow/envs/requirements.in
	pip-compile --quiet --generate-hashes --allow-unsafe --strip-extras --no-emit-options \
	  --no-header --no-annotate --constraint $(LOCK) --output-file - workflow/envs/slurm.in \
	  | grep -A1 '^snakemake-executor' > workflow/envs/slurm.lock

clean: ## Remove the demo, its results and the benchmarks' figures, not the environment
	rm -rf demo results build

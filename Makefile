# Two commands do everything on a fresh machine, set-up included:  make demo,  make test
#
# PYTHON=/path/to/python3.13 names the interpreter; RANKS=4 the number of MPI ranks of demo and test-parallel;
# CORES=1 that of the processes of test; ARGS='-k windkessel' is handed to pytest.

RANKS ?= 2
BIN := .venv/bin
MPIRUN := $(BIN)/mpirun
STAMP := .venv/ready
DOCS_STAMP := .venv/docs-ready
COVERAGE_STAMP := .venv/coverage-ready
LOGS := build/ranks

# Processes of test, one for each core; parts of test-parallel, each in processes of its own.
CORES ?= $(shell env -u OMP_NUM_THREADS nproc 2>/dev/null || echo 1)
PARTS := "tests/solid tests/geometry tests/io tests/runtime tests/post tests/circulation tests/verification" \
	"tests/test_fsi.py tests/coupling tests/fluid tests/bodies tests/run tests/case tests/cli tests/studies tests/benchmarks tests/scripting"

# One thread a rank; the ranks use the cores. A test that hangs (ranks out of step) is ended and shows where.
# PATH in test and test-slow: tests that start mpirun or valvefsi must get those of .venv.
export OMP_NUM_THREADS = 1
export MPLBACKEND = Agg
# Where Python may not keep what it compiles, each of the hundreds of processes of test compiles the package anew.
unexport PYTHONDONTWRITEBYTECODE
PYTEST := $(BIN)/python -m pytest --durations=5 -o faulthandler_timeout=300 -o faulthandler_exit_on_timeout=true

# Which rank a process is: Hydra (MPICH), Open MPI, PMIx. Rank 0 speaks, the others write to files.
RANKED = rank=$${PMI_RANK:-$${OMPI_COMM_WORLD_RANK:-$${PMIX_RANK:-0}}}; \
	if [ $$rank -eq 0 ]; then exec "$$@"; else exec "$$@" >$(LOGS)/rank$$rank.log 2>&1; fi

.PHONY: help setup demo test test-parallel test-slow coverage docs tables lint format clean
.DEFAULT_GOAL := help

help: ## list these commands
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' Makefile

setup: $(STAMP) ## make .venv with everything in it; the other commands do this when needed

$(STAMP): pyproject.toml
	@PYTHON='$(PYTHON)' .ci/setup
	@touch $@

demo: $(STAMP) ## the compressed block in a box of fluid on two ranks: table, pictures, ParaView series
	$(MPIRUN) -n $(RANKS) $(BIN)/python -m valvefsi bench compression --overwrite --out results/compression
	@.ci/setup call

test: $(STAMP) ## the test suite on one rank, a process for each core
	PATH="$(CURDIR)/$(BIN):$$PATH" $(PYTEST) -n $(CORES) --dist worksteal -m 'not slow' $(ARGS)

test-parallel: $(STAMP) ## under mpirun, without the tests that start processes of their own or know of no ranks
	@rm -rf $(LOGS) && mkdir -p $(LOGS)
	@for part in $(PARTS); do \
		echo "mpirun -n $(RANKS): $$part"; \
		$(MPIRUN) -n $(RANKS) sh -c '$(RANKED)' ranked \
			$(PYTEST) -q -p no:cacheprovider -m 'not slow and not serial' $$part $(ARGS) \
			|| { tail -n 60 $(LOGS)/*.log; exit 1; }; \
	done

test-slow: $(STAMP) ## the longer studies
	PATH="$(CURDIR)/$(BIN):$$PATH" $(PYTEST) -m slow $(ARGS)

# Compiled loops are invisible to it and left out; ARGS='tests/circulation' takes some tests, COVER=valvefsi.circulation a part.
COVER ?= valvefsi
coverage: $(COVERAGE_STAMP) ## which lines of the package the test suite reaches: a table, and build/coverage/index.html
	@rm -rf build/coverage && mkdir -p build/coverage
	PATH="$(CURDIR)/$(BIN):$$PATH" $(PYTEST) -n $(CORES) --dist worksteal -m 'not slow' \
		--cov=$(COVER) --cov-report=term --cov-report=html $(ARGS)

$(COVERAGE_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[coverage]'
	@touch $@

docs: $(DOCS_STAMP) ## the documents as web pages, build/docs/index.html; a warning is an error
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs
	@echo build/docs/index.html

$(DOCS_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	@touch $@

tables: $(STAMP) ## write the tables of README and documents from docs/results
	$(BIN)/python docs/tables.py

lint: $(STAMP) ## ruff: rules and format; mypy: annotations
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(STAMP) ## let ruff put the format right
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean: ## remove .venv, caches and logs; results stay
	rm -rf .venv build dist *.egg-info .pytest_cache .ruff_cache .mypy_cache
	find valvefsi tests demos -name __pycache__ -type d -prune -exec rm -rf {} +

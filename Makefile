# Everything a newcomer needs: `make demo` does the main job, `make test` passes the tests.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
RUNS   ?= out/demo
READY  := $(VENV)/.ready
RUNS_HERE := $(VENV)/.runs
# The tests start many programs, each of which would translate all libraries anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test slow golden lint types bench campaign faults fuzz soak load real audit look docs board wheel lock clean

# Every file that is installed has a sum in a lock file; nothing is built from sources.
HASHED := --quiet --no-compile --no-deps --require-hashes --only-binary :all:

# What the simulated bench is compiled with.
COMPILED_WITH := numpy,numba,llvmlite,scipy
INSTALL_PAMRIG = PYTHONWARNINGS=ignore $(BIN)/python -m pip install --no-deps --no-build-isolation \
    --quiet --disable-pip-version-check --editable .

# What a user needs; tests need more.
$(RUNS_HERE): locks/run.lock locks/build.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "pamrig needs Python 3.11 or newer")'
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python tests/install.py locks/build.lock locks/run.lock:$(COMPILED_WITH)
	@echo "compiling the simulated bench (once), while the other packages are installed"
	@$(BIN)/python -m tests.compiling bench & \
	    $(BIN)/python tests/install.py locks/run.lock && $(INSTALL_PAMRIG); \
	    status=$$?; wait; exit $$status
	@touch $@

$(READY): requirements.lock $(RUNS_HERE)
	@$(BIN)/python tests/install.py requirements.lock
	@touch $@

demo: $(RUNS_HERE)   ## an isometric test on the virtual bench, then the thesis's measured table
	@$(BIN)/python -m cli.demo $(RUNS)

# Tests run side by side, each on a processor of its own.
test: export OPENBLAS_NUM_THREADS = 1
test: $(READY)   ## all tests at their small sizes
	@$(BIN)/python -m tests.suite

slow: export OPENBLAS_NUM_THREADS = 1
slow: $(READY)   ## the tests of tests/slow.txt at their small sizes, before what is published
	$(BIN)/python -m pytest -n logical --dist worksteal -m slow

golden: $(READY)   ## golden outputs compared with tests/golden.json.gz; stopped, it goes on
	$(BIN)/python -m tests.golden make out/golden
	$(BIN)/python -m tests.golden compare out/golden

campaign: $(READY)   ## the same tests at full size, and the long ones
	PAMRIG_CAMPAIGN=1 $(BIN)/python -m pytest -m "campaign or not look" -s

faults: $(READY)   ## thousands of runs with things going wrong, and their page; stopped, it goes on
	$(BIN)/python -m tests.faults --processes 2 --page docs/evidence/faults.md

fuzz: $(READY)   ## ten million inputs that nobody would write
	$(BIN)/python -m tests.fuzz --page docs/evidence/fuzz.md

soak: $(READY)   ## a virtual day at 1 kHz and a real hour: memory and completeness, and their page
	$(BIN)/python -m tests.soak --hours 24 --page docs/evidence/soak.md
	$(BIN)/python -m tests.soak --real --page docs/evidence/soak.md

load: $(READY)   ## runs in real time on a busy computer, none vented, and their page
	$(BIN)/python -m tests.overload --privileged --page docs/evidence/overload.md

SECONDS ?= 60
TRIALS ?= 1000
board: $(READY)   ## the firmware on an emulated RP2040: IMAGE=RPI_PICO.uf2 BOOTROM=bootrom.bin
	@$(BIN)/python -m tests.board --image "$(IMAGE)" --bootrom "$(BOOTROM)" --seconds $(SECONDS) \
	    --trials $(TRIALS) --processes 2 --page docs/evidence/board.md

real: $(READY)   ## measured data of others, DATA=FOLDER: docs/evidence/real-data.md says which
	$(BIN)/python -m tests.real "$(DATA)" --page docs/evidence/real-data.md

audit: $(READY)   ## pins and sums of the lock files, an SBOM, and known holes (pip-audit, a network)
	$(BIN)/python -m tests.audit --sbom out/sbom.json

look: $(READY)   ## what needs a browser: the pictures in docs
	$(BIN)/python -m pytest -m look

$(VENV)/.peers: $(READY) locks/peers.lock   # pamrig's own packages stay as they are pinned
	$(BIN)/python -m pip install $(HASHED) -r locks/peers.lock
	@touch $@

bench: $(VENV)/.peers   ## side by side with what one would use instead: docs/evidence/benchmarks.md
	$(BIN)/python -m benchmarks --page docs/evidence/benchmarks.md

$(VENV)/.docs: $(READY) locks/docs.lock   # pamrig's own packages stay as they are pinned
	$(BIN)/python -m pip install $(HASHED) -r locks/docs.lock
	@touch $@

docs: export PATH := $(abspath $(BIN)):$(PATH)
docs: $(VENV)/.docs   ## the reference pages anew, and the documentation as a site: out/docs
	$(BIN)/python -m docs.make
	$(BIN)/python -m sphinx -W --keep-going -q -b html -c docs/make/site docs out/docs
	@echo "out/docs/index.html"

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(READY)
	$(BIN)/mypy

wheel: $(READY)
	$(BIN)/python -m build --wheel --no-isolation --outdir dist .

# Sums of every file of a version: wheels of Linux, macOS and Windows, and the sources.
COMPILE = uv pip compile --quiet --universal --no-header --no-annotate --generate-hashes $(UPGRADE)
EXTRAS  := --extra test --extra dev --extra bench --extra symbolic

lock: UPGRADE ?= --upgrade
lock:   ## pin anew after changing dependencies (needs uv); UPGRADE= keeps the versions
	$(COMPILE) pyproject.toml $(EXTRAS) --output-file requirements.lock
	$(COMPILE) pyproject.toml --constraint requirements.lock --output-file locks/run.lock
	$(COMPILE) --group build --output-file locks/build.lock
	$(COMPILE) pyproject.toml --extra bench --extra peers --constraint requirements.lock --output-file locks/peers.lock
	$(COMPILE) pyproject.toml --extra docs --constraint requirements.lock --output-file locks/docs.lock
	$(COMPILE) --group audit --output-file locks/audit.lock

clean:
	rm -rf $(VENV) build dist out *.egg-info .mypy_cache .ruff_cache .pytest_cache

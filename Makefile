# Two commands matter: `make demo` and `make test`. Each sets up all it needs on its own.
SHELL := /bin/bash
VENV ?= .venv
BIN := $(VENV)/bin
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && command -v $$p && break; done)
PIP_COMPILED = $(BIN)/python -m pip install --quiet --disable-pip-version-check
PIP = $(PIP_COMPILED) --no-compile
OTHER_VERSIONS = echo "note: the tested versions cannot be had here; others are installed, within the ranges of pyproject.toml"
PIP_OF_PYTHON := -c 'import ensurepip, glob, os, sysconfig; \
	print(*glob.glob((sysconfig.get_config_var("WHEEL_PKG_DIR") or os.path.dirname(ensurepip.__file__) + "/_bundled") + "/pip-*.whl"))'
# Libraries are installed without bytecode: the first process that imports a module keeps it for all others.
unexport PYTHONDONTWRITEBYTECODE
OUTPUT ?= runs/demo
SEED ?= 1
# An editable install holds a copy of these files (docs/decisions/0025).
FRONT_DOOR := $(wildcard bench/front_door/*.py)

.PHONY: pictures demo night test test-core test-slow lint types format bench table1 docs lock release clean help
.DEFAULT_GOAL := help

help: ## say what there is
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F':.*## ' '{printf "  make %-10s %s\n", $$1, $$2}'

$(VENV)/made:
	@test -n "$(PYTHON)" || { echo "Starbench needs Python 3.11 or newer; none was found. Install one, or: make PYTHON=/path/to/python"; exit 1; }
	@# The pip that Python brings may be old and slow: run from its wheel, it only fetches a new one.
	@$(PYTHON) -m venv --without-pip $(VENV) \
		&& { PYTHONPATH=$$($(PYTHON) $(PIP_OF_PYTHON)) $(PIP) 'pip>=25' 2>/dev/null || $(BIN)/python -m ensurepip >/dev/null; } \
		|| { echo "Python's venv module is missing; on Debian and Ubuntu: apt install python3-venv"; exit 1; }
	@touch $@

$(VENV)/installed: $(VENV)/made pyproject.toml requirements.lock $(FRONT_DOOR)
	@echo "Installing Starbench into $(VENV) ..."
	@$(PIP) --require-hashes -r requirements.lock || $(OTHER_VERSIONS)
	@$(PIP) --editable .
	@$(BIN)/python -m bench.warm_up
	@touch $@

$(VENV)/installed-dev: $(VENV)/made pyproject.toml requirements-dev.lock $(FRONT_DOOR)
	@echo "Installing Starbench and its test tools into $(VENV) ..."
	@$(PIP_COMPILED) --require-hashes -r requirements-dev.lock || $(OTHER_VERSIONS)
	@$(PIP_COMPILED) --editable '.[dev]'
	@# The second opinions are not built for every platform: tests say so where one is missing.
	@for p in 'evt3>=0.4' 'zaber-motion>=7' 'jsonschema>=4' 'libximc!=3.1.2' 'pymeasure>=0.14' 'dcclib>=0.4' 'xmlschema>=4' 'caproto>=1.1' flirptu 'dsiunits>=3'; do $(PIP_COMPILED) "$$p" \
		|| echo "note: $$p is not to be had here; the tests that ask it are skipped"; done
	@$(BIN)/python -m bench.warm_up
	@touch $@ $(VENV)/installed

$(VENV)/installed-docs: $(VENV)/installed requirements-docs.lock
	@$(PIP_COMPILED) --require-hashes -r requirements-docs.lock || $(OTHER_VERSIONS)
	@$(PIP_COMPILED) --editable '.[docs]'
	@touch $@

demo: $(VENV)/installed ## the main job on the simulated bench: three poses to a sealed report
	@$(BIN)/starbench run sequences/three_pose.yaml --station simulated --seed $(SEED) --output "$(OUTPUT)-$$(date -u +%Y%m%d-%H%M%S)"

night: $(VENV)/installed ## rehearse a night of sixty runs on a virtual clock; one of them fails, as it is meant to
	@$(BIN)/starbench rehearse sequences/night/queue.yaml --begin 2026-03-01T19:30 --output "runs/night-$$(date -u +%Y%m%d-%H%M%S)"; test $$? -le 1

# Arrays that tests free stay with their process: to have each page cleared by the system again costs a tenth of the time.
test test-core test-slow: export MALLOC_MMAP_THRESHOLD_ = 33554432
test test-core test-slow: export MALLOC_TRIM_THRESHOLD_ = 1000000000

test: $(VENV)/installed-dev lint types ## every check that CI runs
	$(BIN)/pytest -n 4 --dist worksteal -m "not slow" --durations=100

test-core: $(VENV)/installed-dev ## the tests of the core alone, without those of extras and documents
	$(BIN)/pytest -n 4 --dist worksteal -m "not slow" --ignore=tests/extras --ignore=bench/extras --ignore=tests/unit/documents

test-slow: $(VENV)/installed-dev ## the long ones: kills, seeds, Monte Carlo
	$(BIN)/pytest -m slow

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(VENV)/installed-dev
	$(BIN)/mypy

format: $(VENV)/installed-dev ## put the code into its form
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(VENV)/installed-dev ## speeds (never part of the tests)
	for speed in convert fit pixels; do $(BIN)/python tests/benchmarks/bench_$$speed.py || exit 1; done

table1: $(VENV)/installed-dev ## methods compared where the truth is known: about an hour of two cores; Ctrl-C, and it continues
	@$(PIP_COMPILED) 'optiland>=0.6' || echo "note: optiland is not to be had here; the collimators of strangers are left out"
	$(BIN)/python tests/benchmarks/bench_table1.py --jobs 2 --pictures docs/pictures --write
	$(BIN)/python tests/benchmarks/bench_image_counts.py --jobs 2 --pictures docs/pictures --write

pictures: $(VENV)/installed-dev ## make the pictures of README and documents again, from the present version; needs Chromium
	$(BIN)/python -m tests.extras.support.document_pictures

docs: $(VENV)/installed-docs ## the documents as a site, in build/site; open build/site/index.html
	$(BIN)/python -m sphinx --builder html --fail-on-warning --keep-going --quiet --doctree-dir build/doctrees docs build/site
	@echo "Open build/site/index.html"

lock: $(VENV)/made ## write down the newest versions within the ranges of pyproject.toml, with their hashes
	$(PIP) 'uv>=0.13'
	for set in "requirements" "requirements-all $(EXTRAS:%=--extra %) --constraint requirements.lock" "requirements-dev --extra dev" "requirements-docs --extra docs --constraint requirements-dev.lock"; do set -- $$set; \
		$(BIN)/uv pip compile pyproject.toml $${@:2} -o $$1.lock --quiet --upgrade --universal --python-version 3.11 --generate-hashes \
			--no-emit-index-url --no-annotate --custom-compile-command "make lock" || exit 1; done

EXTRAS := evk4 visa apprise formats table cluster draw certificate

# The same commit gives the same bytes anywhere: times in the archives are those of the commit. The list of parts is that of
# an environment of its own, with all extras, as licences stand in installed packages.
release: export SOURCE_DATE_EPOCH = $(shell git log -1 --format=%ct)
release: $(VENV)/made ## wheel, source and list of parts (SBOM) in dist/, with SHA256SUMS; KEY=file signs it
	@test -z "$$(git status --porcelain)" || { echo "There are changes that are not committed. Commit them first: a release is made of a commit."; exit 1; }
	@$(PIP) 'build>=1.2' 'hatchling>=1.25' 'cyclonedx-bom>=7'
	rm -rf dist && umask 022 && $(BIN)/python -m build --no-isolation --outdir dist . >/dev/null
	rm -rf build/parts && $(PYTHON) -m venv --without-pip build/parts
	$(BIN)/python -m pip --python build/parts/bin/python install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements-all.lock
	$(BIN)/cyclonedx-py environment build/parts/bin/python --pyproject pyproject.toml --output-reproducible -o dist/starbench.cdx.json 2>/dev/null
	cd dist && sha256sum *.whl *.tar.gz *.json > SHA256SUMS && cat SHA256SUMS
	@if test -n "$(KEY)"; then ssh-keygen -Y sign -f "$(KEY)" -n starbench-release@v1 dist/SHA256SUMS; \
	else echo "Not signed. To sign: make release KEY=~/.config/starbench/bench_key"; fi

clean: ## remove the virtual environment and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

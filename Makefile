# Everything a person does with this repository. `make help` lists it.
# Needs Python 3.11 or newer with its venv module, a Rust toolchain and a C compiler; the rest goes into .venv and target.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
STAMPS := .venv/stamps
RUST_SOURCES := $(shell find crates -name '*.rs' -o -name Cargo.toml) Cargo.toml Cargo.lock

# maturin builds into this environment, whatever is active in the caller's shell
export VIRTUAL_ENV := $(CURDIR)/.venv
unexport CONDA_PREFIX
unexport PYTHONPATH
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_CONSTRAINT := $(CURDIR)/constraints.txt
# the interpreter that pyo3 configures itself for: the same for cargo and for maturin, or it is compiled twice
export PYO3_PYTHON := $(CURDIR)/$(BIN)/python

# property tests draw the same cases on every run: a check that fails by chance is no check
export PROPTEST_RNG_SEED := 2007

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
# the steps of `check` speak in turn; cargo and the solver use all cores by themselves
.NOTPARALLEL:

## Use

demo: $(STAMPS)/package $(STAMPS)/video $(STAMPS)/images  ## build, then film a walk, reconstruct it and compare with the truth
	$(BIN)/panopath demo

install: $(STAMPS)/package $(STAMPS)/plot  ## build the package into .venv, with what the pictures need

test: test-rust test-python  ## Rust and Python tests

check: format lint types stubs layers test  ## everything that must hold before a change is merged

## Parts of check

format: $(STAMPS)/dev  ## are all files formatted?
	cargo fmt --check
	$(BIN)/ruff format --check .

lint: $(STAMPS)/dev  ## clippy and ruff
	cargo clippy --workspace --all-targets --quiet -- -D warnings
	RUSTDOCFLAGS='-D warnings' cargo doc --no-deps --quiet -p panopath
	$(BIN)/ruff check .

types: $(STAMPS)/package $(STAMPS)/dev  ## mypy --strict
	$(BIN)/mypy

stubs: $(STAMPS)/package $(STAMPS)/dev  ## does _core.pyi say what the compiled module has?
	$(BIN)/stubtest panopath._core

layers: $(STAMPS)/package $(STAMPS)/dev  ## do imports run one way?
	$(BIN)/lint-imports
	@! grep -rnE --include='*.py' '^ *(from panopath import|import panopath)' python/panopath | grep -v 'from panopath import _core$$'

test-rust: $(STAMPS)/venv  ## cargo test, with the documentation's examples
	cargo test --workspace

test-python: $(STAMPS)/package $(STAMPS)/dev  ## pytest
	$(BIN)/pytest

## Make

fix: $(STAMPS)/dev  ## format all files and mend what the linters can
	cargo fmt
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(STAMPS)/package $(STAMPS)/peers  ## measure against other programs and write the pages of benchmarks (long)
	$(BIN)/python -m benchmarks.run
	$(BIN)/python -m benchmarks.free_page

bench-rust: $(STAMPS)/venv  ## criterion: one group a step
	cargo bench --workspace

docs: $(STAMPS)/package $(STAMPS)/docs  ## the pages as a site, with the reference of Python: site/index.html
	rm -rf site
	$(BIN)/python -m sphinx --builder html --fresh-env --fail-on-warning --keep-going --quiet --conf-dir docs \
		--doctree-dir target/doctrees . site
	@echo "open site/index.html"

docs-figures: $(STAMPS)/package $(STAMPS)/plot  ## draw the pictures of README and docs again
	$(BIN)/python docs/figures.py
	$(BIN)/python -m docs.figures_certificate
	$(BIN)/python -m docs.figures_counting
	$(BIN)/python -m docs.figures_view
	$(BIN)/python -m docs.figures_reconstruct
	$(BIN)/python -m docs.figures_moving
	$(BIN)/python -m docs.figures_paper
	$(BIN)/python examples/coast_survey.py docs/img/tutorial/coast.png

# On Linux zig links against an older C library than the one of this machine, so that the wheel runs on more of them.
wheel: $(STAMPS)/venv  ## an optimised wheel in dist, for Python 3.11 and newer on this platform
	rm -f dist/panopath-*.whl
ifeq ($(shell uname -s),Linux)
	$(BIN)/python -m pip install --quiet ziglang
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/maturin build --release --locked --zig --compatibility manylinux_2_28 --out dist
else
	$(BIN)/maturin build --release --locked --out dist
endif

sdist: $(STAMPS)/venv  ## the sources in dist, as an archive that pip can build
	rm -f dist/panopath-*.tar.gz
	$(BIN)/maturin sdist --out dist

# Nothing of this folder is seen there: what the wheel lacks is missing.
check-dist: wheel sdist  ## install the wheel with all extras, and the sources alone, into empty environments; run them
	rm -rf dist/wheel-venv dist/sdist-venv dist/demo
	$(PYTHON) -m venv dist/wheel-venv
	cd dist && wheel-venv/bin/python -m pip install --quiet "$$(ls -d "$$PWD"/panopath-*.whl)[all]"
	cd dist && wheel-venv/bin/panopath doctor && wheel-venv/bin/panopath demo --out demo
	$(PYTHON) -m venv dist/sdist-venv
	cd dist && sdist-venv/bin/python -m pip install --quiet panopath-*.tar.gz
	cd dist && sdist-venv/bin/panopath --version

clean:  ## remove what make made: .venv, target, dist and caches
	rm -rf .venv target dist site .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	rm -f python/panopath/_core*.so

help:  ## this list
	@awk -F ':.*## ' '/^## /{print "\n" substr($$0, 4)} /^[a-z-]+:.*## /{printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

# Stamps: an empty file says that a step is done and still holds.

$(STAMPS)/venv: constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "panopath needs Python 3.11 or newer: make PYTHON=/path/to/python" >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet maturin
	@mkdir -p $(STAMPS) && touch $@

$(STAMPS)/package: $(STAMPS)/venv pyproject.toml $(RUST_SOURCES)
	$(BIN)/maturin develop --profile dev
	@touch $@

# The package is there already, so pip adds only what its extra names.
$(STAMPS)/plot $(STAMPS)/video $(STAMPS)/images $(STAMPS)/docs $(STAMPS)/dev $(STAMPS)/peers: $(STAMPS)/venv pyproject.toml | $(STAMPS)/package
	$(BIN)/python -m pip install --quiet 'panopath[$(@F)]'
	@touch $@

.PHONY: demo install test check format lint types stubs layers test-rust test-python fix bench bench-rust \
	docs docs-figures wheel sdist check-dist clean help

# On a fresh machine with Python >= 3.11 and make: `make quickstart` runs a real study, `make test` runs all checks.
# Packages come from wherever pip is set up to find them, at the versions of constraints.txt.

VENV ?= .venv
STUDY ?= studies/quickstart.yaml
LAB ?= lab
PYTEST_ARGS ?= -n auto

# The first interpreter that is new enough, unless PYTHON names one.
PYTHON ?= $(shell for python in python3 python3.14 python3.13 python3.12 python3.11 python; do \
	$$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$python; break; }; done)
BIN := $(VENV)/bin
# bytecode is kept, whatever the environment says: else each process of the tests compiles all sources and all asserts
PYTEST = PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest $(PYTEST_ARGS)
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: help quickstart web-demo lint check test test-all docs clean
.DELETE_ON_ERROR:

help:
	@echo "make quickstart   set up, run $(STUDY) and write its report"
	@echo "make web-demo     the same if it was not done, and its pages in a browser"
	@echo "make check        set up, then ruff, import-linter, pyright and the tests that need no kernels, in a minute or two"
	@echo "make test         set up, then ruff, import-linter, pyright and the tests, in up to twenty minutes"
	@echo "make test-all     the same with the tests that take a long way round: before a release"
	@echo "make lint         set up, then ruff, import-linter, the count of unclear names and docstrings, and pyright"
	@echo "make docs         write docs/commands.md, the tables of docs/studies.md and the types of keys, and build the site of all pages in site/"
	@echo "make clean        remove $(VENV)"

quickstart: $(VENV)/installed-run
	$(BIN)/labbook run $(STUDY) --lab $(LAB)
	$(BIN)/labbook report $(STUDY) --lab $(LAB)

web-demo: $(VENV)/installed-web
	@test -d $(LAB)/runs || $(MAKE) quickstart
	$(BIN)/labbook web $(STUDY) --lab $(LAB)

define style
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-logo
	$(BIN)/python tests/language.py
endef

# pyright goes on beside the tests that $(1) chooses: it takes one core a minute and more
define all-checks
	$(style)
	@$(BIN)/pyright > $(VENV)/types 2>&1 & types=$$!; \
		$(PYTEST) $(1); tests=$$?; \
		wait $$types; types=$$?; cat $(VENV)/types; exit $$((tests | types))
endef

lint: $(VENV)/installed-dev
	$(style)
	$(BIN)/pyright

check: $(VENV)/installed-dev
	$(call all-checks,-m "not compiles and not render and not slow and not ring and not browser")

test: $(VENV)/installed-dev
	$(call all-checks,-m "not ring and not browser")

test-all: $(VENV)/installed-dev
	$(call all-checks,)

docs: $(VENV)/installed-dev
	$(BIN)/python -m labbook.cli.reference docs/commands.md
	$(BIN)/python -m labbook.study.page docs/studies.md
	$(BIN)/python -m labbook.study.static labbook/study/stated.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build
	@echo "The documentation is in site/index.html"

clean:
	rm -rf $(VENV)

$(VENV)/bin/python:
	@test -n "$(PYTHON)" || { echo "labbook needs Python 3.11 or newer; none is on the PATH (or say make PYTHON=...)"; exit 1; }
	@echo "Creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
		echo "$(PYTHON) could not make a virtual environment; on Debian: apt-get install python3-venv"; exit 1; }

# An installation is redone only when what it was made from has changed.
$(VENV)/installed-run: pyproject.toml labbook/version.py constraints.txt | $(VENV)/bin/python
	@echo "Installing labbook with its CPU backend (once; a minute or two)"
	@$(INSTALL) --editable '.[numba]'
	@touch $@

$(VENV)/installed-web: pyproject.toml labbook/version.py constraints.txt | $(VENV)/installed-run
	@echo "Installing the web app and the viewer (once; 500 MB)"
	@$(INSTALL) --editable '.[numba,web,viewer]'
	@touch $@

$(VENV)/installed-dev: pyproject.toml labbook/version.py constraints.txt | $(VENV)/bin/python
	@echo "Installing labbook with everything that its tests need (once; a few minutes)"
	@$(INSTALL) --editable '.[dev]'
	@touch $@ $(VENV)/installed-run $(VENV)/installed-web

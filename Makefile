# make demo: render, calibrate and compare.  make test: what CI runs.  make lint: the checks without the tests.
# make fast: the fast tests alone.  make coverage: their branch coverage, with a floor.  make mutants: do the fast tests notice when
# a guard is taken out?
# make docs: the pages that scripts write, and the site in build/site.
# Each makes .venv and the compiled kernel first, and anew when pyproject.toml, constraints.txt or a kernel changes; the demonstration needs
# no more than a user has, the tests also what trains the agent.

VENV := .venv
BIN := $(VENV)/bin
PYTHONS := python3 python3.14 python3.13 python3.12 python3.11 python
IS_NEW_ENOUGH := import sys; sys.exit(sys.version_info < (3, 11))

.PHONY: demo test fast lint coverage mutants sanitize docs

demo: $(VENV)/.core
	@$(BIN)/binocal demo --output binocal-demo --force

test: lint
	$(BIN)/pytest -n auto --dist worksteal

fast: $(VENV)/.stamp
	$(BIN)/pytest -n auto --dist worksteal -m "not slow"

coverage: $(VENV)/.stamp
	@mkdir -p build/coverage && rm -f build/coverage/data*
	$(BIN)/coverage run -m pytest -q -n auto -m "not slow"
	$(BIN)/coverage combine -q
	$(BIN)/coverage report

mutants: $(VENV)/.stamp
	$(BIN)/python tests/mutants/run.py

lint: $(VENV)/.stamp
	$(BIN)/ruff check src tests docs examples benchmarks
	$(BIN)/ruff format --check src tests docs examples benchmarks
	$(BIN)/lint-imports
	$(BIN)/pyright --pythonpath $(BIN)/python

# The kernel's tests and a fuzzer of its functions, under AddressSanitizer and UndefinedBehaviorSanitizer (GCC or Clang on Linux).
SANITIZED := build/sanitize
sanitize: $(VENV)/.stamp
	$(PIP_INSTALL) nanobind cmake ninja
	rm -rf $(SANITIZED)/src && mkdir -p $(SANITIZED)/src && cp -r src/binocal $(SANITIZED)/src/ && rm -f $(SANITIZED)/src/binocal/kernels/_kernel*.so
	$(BIN)/cmake -S . -B $(SANITIZED)/cmake -G Ninja -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(BIN)/ninja -DPython_EXECUTABLE=$(CURDIR)/$(BIN)/python \
	  -DBINOCAL_SANITIZE=ON -DBINOCAL_OUTPUT=$(CURDIR)/$(SANITIZED)/src/binocal/kernels >/dev/null
	$(BIN)/cmake --build $(SANITIZED)/cmake
	for tests in tests/kernels tests/kernels/fuzz.py; do \
	  LD_PRELOAD="$$($(CXX) -print-file-name=libasan.so) $$($(CXX) -print-file-name=libubsan.so)" UBSAN_OPTIONS=print_stacktrace=1 \
	  ASAN_OPTIONS=detect_leaks=0:allocator_may_return_null=1 BINOCAL_FUZZ_ROUNDS=2000 PYTHONPATH=$(SANITIZED)/src \
	  $(BIN)/python -m pytest -q -p no:cacheprovider $$tests || exit 1; \
	done

docs: $(VENV)/.stamp
	$(PIP_INSTALL) -e '.[docs]'
	$(BIN)/python docs/make_cli_reference.py
	$(BIN)/python docs/make_findings.py
	$(BIN)/python docs/make_architecture.py
	$(BIN)/python docs/make_figure.py
	$(BIN)/python docs/make_chessboard_figures.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

PIP_INSTALL := PIP_CONSTRAINT=constraints.txt PIP_BUILD_CONSTRAINT=constraints.txt \
  $(BIN)/python -m pip install --quiet --disable-pip-version-check
KERNEL := CMakeLists.txt $(wildcard src/binocal/kernels/cpp/*.cpp src/binocal/kernels/cpp/*.hpp)

$(VENV)/.core: pyproject.toml constraints.txt $(KERNEL)
	@if ! $(BIN)/python -c '$(IS_NEW_ENOUGH)' 2>/dev/null; then \
	  found=; \
	  for name in $(PYTHONS); do \
	    if "$$name" -c '$(IS_NEW_ENOUGH)' 2>/dev/null; then found=$$name; break; fi; \
	  done; \
	  if [ -z "$$found" ]; then \
	    echo "binocal needs Python 3.11 or newer, and none is on the PATH (looked for: $(PYTHONS)); get it from https://www.python.org/downloads/." >&2; \
	    exit 1; \
	  fi; \
	  if ! "$$found" -m venv --clear $(VENV); then \
	    echo "$$found cannot make a virtual environment; on Debian and Ubuntu: apt install python3-venv." >&2; \
	    exit 1; \
	  fi; \
	fi
	$(PIP_INSTALL) -e .
	@touch $@

# The package is there: its name with the extra adds what that needs, and the kernel is not compiled again.
$(VENV)/.stamp: $(VENV)/.core
	$(PIP_INSTALL) 'binocal[test]'
	@touch $@

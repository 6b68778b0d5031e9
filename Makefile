# make demo: the main job in two processes.  make test: the tests.  Both set up what they need.
# make test-all: long statistics and further starts of processes too, and how much of the nodes the
# tests run through.
# PYTHON=python3.12 chooses another Python, CONSTRAINTS=FILE other versions than the locked ones.

PYTHON ?= python3
VENV ?= .venv
CONSTRAINTS ?=
# BROWSER=no does not install a browser for the test of the report, which is then skipped.
BROWSER ?= yes
PYTEST_ARGS ?=

# The kernels are small: threads of BLAS cost more than they give.
export OPENBLAS_NUM_THREADS = 1

version := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
ros := $(shell $(PYTHON) -c 'import rclpy' 2>/dev/null && echo sourced || echo wheels)
ready := $(VENV)/.ready-$(version)-$(ros)-$(notdir $(CONSTRAINTS))
python := $(VENV)/bin/python
tested := $(ready) $(if $(filter no,$(BROWSER)),,$(VENV)/.browser)

.PHONY: demo test test-all lint docs data figures benchmark report clean

demo: $(ready)
	$(python) -m star_tracker.nodes.demo

# A file's tests stay together, as they share what they have made.
pytest := pytest -n auto --dist loadfile --no-loadscope-reorder

test: $(tested)
	$(python) -m $(pytest) $(PYTEST_ARGS)

test-all: $(tested)
	$(python) -m coverage erase
	$(python) -m coverage run -m $(pytest) -m "" $(PYTEST_ARGS)
	$(python) -m coverage combine --quiet
	$(if $(PYTEST_ARGS),,$(python) -m coverage report)

lint: $(ready)-lint docs
	$(python) -m ruff check .
	$(python) -m mypy

# The pages and the API reference: build/docs/index.html. Warnings and broken references fail it.
docs: $(ready)-docs
	$(python) -m sphinx --builder html --fail-on-warning --keep-going --nitpicky --fresh-env \
		--quiet docs build/docs

# Rebuilds the shipped catalogue and star maps; git diff shows that nothing changed.
data: $(ready)
	$(python) data/build_catalog.py
	$(python) data/build_star_maps.py

# The pictures of README.md and docs/, in a few minutes.
figures: $(ready)
	$(python) benchmark/make_figures.py $(ARGS)

# Against other star identifiers: hours; ARGS=--quick takes some minutes. It resumes.
benchmark: $(ready)-benchmark
	$(python) -m star_tracker.commands.cli evaluate --config benchmark/benchmark.yaml \
		--output benchmark/results/peers --jobs 1 $(ARGS)
	cp benchmark/results/peers/report.md benchmark/RESULTS.md

# The robustness report, in some minutes; what is done is kept in benchmark/results.
report: $(ready)
	$(python) -m star_tracker.commands.cli evaluate --output benchmark/results
	cp benchmark/results/curves.png docs/robustness.png

$(VENV)/.browser: requirements/browser.sh $(ready)
	sh requirements/browser.sh "$(VENV)"
	touch $@

$(ready): requirements/python.txt requirements/ros.txt requirements/install.sh setup.py $(CONSTRAINTS)
	sh requirements/install.sh "$(PYTHON)" "$(VENV)" "$(ros)" "$(CONSTRAINTS)"
	touch $@

$(ready)-lint: requirements/lint.txt $(ready)
	sh requirements/install.sh --lint "$(VENV)"
	touch $@

$(ready)-docs: requirements/docs.txt $(ready)
	sh requirements/install.sh --docs "$(VENV)"
	touch $@

$(ready)-benchmark: requirements/benchmark.txt $(ready)
	sh requirements/install.sh --benchmark "$(VENV)"
	touch $@

clean:
	rm -rf $(VENV) build install log .coverage* .mypy_cache .pytest_cache .ruff_cache *.egg-info

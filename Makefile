# `make run` and `make test` need nothing but Python 3.11 or newer: the first of them sets up .venv.

PYTHON ?= python3
VENV   := .venv
READY  := $(VENV)/.ready
RAY    := $(VENV)/.ray
GYM    := $(VENV)/.gym
CHROMIUM := $(VENV)/.chromium
DEMO   := runs/demo
SUDO   := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
FILM   := $(VENV)/bin/musebot film $(DEMO) --proposer creative --robot 0 --phase post --seconds 30

# $(call apt_install,PACKAGES,WHY), for use inside a shell command.
apt_install = { \
	command -v apt-get >/dev/null || { \
	  echo "No apt-get here: for $(2), install what Debian calls $(1) your own way." >&2; false; }; \
	} && $(SUDO) apt-get update && \
	$(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $(1)

.DEFAULT_GOAL := help
.PHONY: help run test lint gym cluster clean

help:  ## list these targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-7s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

run: $(READY)  ## eight creative robots live through both tasks, then a film of each, in runs/demo
	$(VENV)/bin/musebot run $(DEMO) --robots 8 --proposer creative
	mkdir -p $(DEMO)/films
	$(FILM) --task wall_avoidance --speed 4 --output $(DEMO)/films/wall_avoidance.mp4
	$(FILM) --task spot_finding --speed 60 --output $(DEMO)/films/spot_finding.mp4

test: $(READY) $(RAY) $(GYM) $(CHROMIUM)  ## run the tests
	@$(VENV)/bin/pytest -q -n 2 tests

lint: $(READY) $(RAY) $(GYM)  ## check style, format and types
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/pyright --pythonpath $(VENV)/bin/python

gym: $(READY)  ## Gymnasium and Stable-Baselines3, into .venv
	$(VENV)/bin/pip install --no-deps -r constraints-gym.txt

cluster: $(READY)  ## Ray, into .venv
	$(VENV)/bin/pip install --no-deps -r constraints-cluster.txt

clean:  ## remove .venv and caches, never runs/
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .ruff_cache .hypothesis

# Without EGL everything but pictures works, so its absence warns and goes on. Torch comes first, with
# what its build for this machine needs; the rest is exactly constraints.txt, which leaves out labmaze
# where it cannot be built (a plain `pip install -e .` would insist on it, for dm-control's mazes).
$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "Musebot needs Python 3.11 or newer: name one with 'make PYTHON=/path/to/python3'." >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { \
	  venv=$$($(PYTHON) -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])'); \
	  $(call apt_install,$$venv,virtual environments); }
	@[ "$$(uname)" != Linux ] || { \
	  found=$$(PATH=$$PATH:/usr/sbin:/sbin ldconfig -p); \
	  echo "$$found" | grep -q 'libEGL\.so\.1' && echo "$$found" | grep -q 'libEGL_.*\.so\.0'; } || { \
	  $(call apt_install,libegl1 libegl-mesa0 libgl1-mesa-dri,pictures and films); } || \
	  echo "Going on without EGL: 'musebot film' will not work yet." >&2
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install -c constraints.txt torch
	$(VENV)/bin/pip install --no-deps -r constraints.txt -e .
	@touch $@

# Only the test of the report opens a browser, and skips itself without one: 113 MB to fetch.
$(CHROMIUM): $(READY)
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || \
	{ $(call apt_install,chromium,the test of the report); } || \
	  echo "Going on without chromium: the report will not be opened in a browser." >&2
	@touch $@

# A quarter of a gigabyte that only the tests of the cluster need: they skip themselves without it.
$(RAY): $(READY) constraints-cluster.txt
	$(VENV)/bin/pip install --no-deps -r constraints-cluster.txt || \
	  echo "Going on without Ray: the tests of the cluster will be skipped." >&2
	@touch $@

# Likewise what only users of Gymnasium need.
$(GYM): $(READY) constraints-gym.txt
	$(VENV)/bin/pip install --no-deps -r constraints-gym.txt || \
	  echo "Going on without Gymnasium: the tests of its doors will be skipped." >&2
	@touch $@

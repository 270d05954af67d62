# `make run` and `make test` require only Python 3.11 or newer; each creates .venv if there is none.

PYTHON ?= python3
VENV   := .venv
READY  := $(VENV)/.ready
EXTRAS := $(VENV)/.cluster $(VENV)/.gym $(VENV)/.warp
CHROMIUM := $(VENV)/.chromium
DEMO   := runs/demo
SUDO   := $(shell [ "$$(id -u)" = 0 ] || echo sudo)

# $(call apt_install,PACKAGES,PURPOSE), for use inside a shell command.
apt_install = { \
	command -v apt-get >/dev/null || { \
	  echo "apt-get not found: for $(2), install the equivalents of Debian's $(1)." >&2; false; }; \
	} && $(SUDO) apt-get update && \
	$(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $(1)

.DEFAULT_GOAL := help
.PHONY: help run test lint gym cluster warp docs pictures dist clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-8s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

run: $(READY)  ## film a trained policy, let 60 robots learn, write their page; in runs/demo
	mkdir -p $(DEMO)
	$(VENV)/bin/musebot film --task spot_finding --output $(DEMO)/trained.mp4 --seconds 6
	$(VENV)/bin/musebot run $(DEMO)/robots --body kinematic --set backend=numba cohort_size=30 --life wall_avoidance --proposer creative --robots 60
	$(VENV)/bin/musebot report $(DEMO)/robots

test: $(READY) $(EXTRAS) $(CHROMIUM)  ## run the tests
	@$(VENV)/bin/pytest -q -n 2 --dist worksteal tests

lint: $(READY) $(EXTRAS)  ## check style, format and types
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/pyright --pythonpath $(VENV)/bin/python

gym: $(VENV)/.gym  ## install Gymnasium, Stable-Baselines3 and TensorBoard in .venv
cluster: $(VENV)/.cluster  ## install Ray in .venv
warp: $(VENV)/.warp  ## install MuJoCo Warp in .venv
gym cluster warp:
	@test -e $<

docs: $(READY) $(VENV)/.gym $(VENV)/.docs  ## build the documentation in site/
	@test -e $(VENV)/.docs
	$(VENV)/bin/python docs/generator
	rm -rf site
	$(VENV)/bin/zensical build --strict --clean
	rm -rf site/generator; find site -name '*.safetensors*' -delete
	$(VENV)/bin/python docs/generator/check_site.py site

pictures: $(READY)  ## make the films and pictures of the documents anew
	$(VENV)/bin/python docs/generator/pictures.py

dist: $(READY)  ## build the wheel and the sdist in dist/
	@! grep -n 'example\.org' pyproject.toml >&2 || { \
	  echo "Name the project's addresses in pyproject.toml first." >&2; exit 1; }
	rm -rf build dist *.egg-info
	$(VENV)/bin/python -c 'from setuptools import build_meta as build; \
	  build.build_sdist("dist"); build.build_wheel("dist")' >/dev/null
	@rm -rf build *.egg-info; ls -l dist

clean:  ## remove .venv, builds and caches; keep runs/
	rm -rf $(VENV) build dist site .cache *.egg-info .pytest_cache .ruff_cache .hypothesis

# Only images and films need EGL, so its absence is a warning. Torch is installed first, with the
# dependencies of its build for this machine. The rest is exactly constraints/base.txt, which omits labmaze
# where it cannot be built; a plain `pip install -e .` would require it for dm-control's mazes.
# Type checkers do not run the code by which pip finds this folder. They follow a path that holds a
# folder `musebot`, which here is a link to the root.
$(READY): pyproject.toml constraints/base.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "Musebot requires Python 3.11 or newer: 'make PYTHON=/path/to/python3' selects one." >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { \
	  venv=$$($(PYTHON) -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])'); \
	  $(call apt_install,$$venv,virtual environments); }
	@[ "$$(uname)" != Linux ] || { \
	  found=$$(PATH=$$PATH:/usr/sbin:/sbin ldconfig -p); \
	  echo "$$found" | grep -q 'libEGL\.so\.1' && echo "$$found" | grep -q 'libEGL_.*\.so\.0'; } || { \
	  $(call apt_install,libegl1 libegl-mesa0 libgl1-mesa-dri,images and films); } || \
	  echo "Continuing without EGL: 'musebot film' will not work." >&2
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install -c constraints/base.txt torch
	$(VENV)/bin/pip install --no-deps -r constraints/base.txt -e .
	mkdir -p $(VENV)/src
	ln -sfn "$(CURDIR)" $(VENV)/src/musebot
	packages=$$($(VENV)/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))') && \
	  echo "$(abspath $(VENV))/src" > "$$packages/musebot-sources.pth"
	@touch $@

# Only the report's test needs a browser (113 MB), and only those of windows need a display; they are
# skipped without one.
$(CHROMIUM): $(READY)
	@{ command -v chromium || command -v chromium-browser; } >/dev/null && \
	command -v Xvfb >/dev/null || { $(call apt_install,chromium xvfb,tests of pages and windows); } || \
	  echo "Continuing without chromium or Xvfb: tests of pages or windows will be skipped." >&2
	@touch $@

# Ray (250 MB), Gymnasium, MuJoCo Warp (410 MB), and Zensical for the site (110 MB). What needs one
# of them is skipped in the tests without it. A failed installation is tried again the next time.
$(VENV)/.%: $(READY) constraints/%.txt
	@rm -f $@
	$(VENV)/bin/pip install --no-deps -r constraints/$*.txt && touch $@ || \
	  echo "Continuing without constraints/$*.txt: what needs it will not work." >&2

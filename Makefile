# `make test` and `make demo` need Python 3.10 to 3.13 and, the first time only, the network.
# PYTHON=python3.12 chooses the interpreter; without it an existing .venv is kept as it is.

export OMP_NUM_THREADS ?= 1
BIN := .venv/bin
COLCON_VENV := build/colcon_venv
COLCON_WS := build/colcon_ws
SUPPORTED := import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))
SHOW_VERSION := import sys; print(sys.version_info[:2])

NODES = $(shell $(BIN)/python -c 'from mbd_ros.nodes.table import NODES; print(*NODES)')

# uv takes seconds where pip takes a minute; pip takes over where uv cannot, as behind a mirror that only pip is told of.
install = $(BIN)/uv pip install --quiet --compile-bytecode --link-mode copy --python $(BIN)/python -r $(1) 2>/dev/null || \
	$(BIN)/python -m pip install --quiet --use-pep517 -r $(1)

# The loop takes the first that really runs: a pyenv shim exists and fails.
FIND_PYTHON = for python in $(or $(PYTHON),python3 python3.13 python3.12 python3.11 python3.10); do \
	"$$python" -c '$(SUPPORTED)' 2>/dev/null && break; python=; done; \
	test -n "$$python" || { echo "mbd_ros needs Python 3.10, 3.11, 3.12 or 3.13; not found:" \
	"$(or $(PYTHON),python3 python3.10 .. python3.13). Name one: make PYTHON=/path/to/python" >&2; exit 1; }

ifdef PYTHON
ifneq ($(shell $(PYTHON) -c '$(SHOW_VERSION)' 2>&1),$(shell test -x $(BIN)/python && $(BIN)/python -c '$(SHOW_VERSION)'))
OTHER_PYTHON := other_python
endif
endif

.PHONY: venv check test browser calculix demo lint format report docs licences links picture soak fuzz fuzz-nodes bench against imports colcon clean other_python

venv: .venv/installed

.venv/pinned: requirements/pins.txt $(OTHER_PYTHON)
	@$(FIND_PYTHON); rm -rf .venv; "$$python" -m venv .venv || { rm -rf .venv; \
	echo "$$python has no working venv module: install python3-venv" >&2; exit 1; }
	$(BIN)/python -m pip install --quiet "$$(grep '^uv==' requirements/pins.txt)"
	$(call install,requirements/pins.txt)
	@touch $@

.venv/installed: .venv/pinned setup.py setup.cfg pyproject.toml
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .
	@touch $@

CHECKS := test/house/test_house.py test/house/test_architecture.py test/parts/test_contracts.py \
	test/parts/test_part_contracts.py test/scene/test_kinds_of_scenes.py

# What most mistakes break, in two minutes: contracts, the house, one scene of each kind, one node.
check: venv
	$(BIN)/python -m pytest -n 2 --dist worksteal $(CHECKS)
	$(BIN)/python -m pytest test/nodes/test_inverse_dynamics_streams.py -m "not soak and not alone"

# APT=no installs nothing by apt-get: the table at the end says which tests were skipped for it.
test: venv .venv/report .venv/docs $(if $(filter no,$(APT)),,browser calculix)
	$(BIN)/python test/support/steps.py

# For tests of pages. Where nothing may be installed they are skipped, and say why.
browser:
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null || { \
	export DEBIAN_FRONTEND=noninteractive; timeout 300 apt-get update -qq && \
	timeout 600 apt-get install -y -qq --no-install-recommends chromium; } </dev/null || \
	echo "Chromium is missing and cannot be installed here: tests in a browser are skipped" >&2

# For tests of finite elements, likewise.
calculix:
	@command -v ccx >/dev/null || { export DEBIAN_FRONTEND=noninteractive; timeout 300 apt-get update -qq && \
	timeout 300 apt-get install -y -qq --no-install-recommends calculix-ccx; } </dev/null || \
	echo "CalculiX is missing and cannot be installed here: tests that solve are skipped" >&2

demo: venv
	$(BIN)/mbd-ros demo -o demo_out

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: venv
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

.venv/report: requirements/report.txt .venv/installed
	$(call install,requirements/report.txt)
	@touch $@

report: venv .venv/report
	$(BIN)/mbd-ros report -o report_out

.venv/docs: requirements/docs.txt .venv/report
	$(call install,requirements/docs.txt)
	@touch $@

docs: venv .venv/docs
	$(BIN)/python docs/site/build.py docs_out
	@echo "docs: docs_out/index.html"

# The page is part of the sources: only a new pin changes it.
licences: venv .venv/docs $(COLCON_VENV)/pinned
	$(BIN)/python docs/site/licences.py $(BIN)/python $(COLCON_VENV)/bin/python

picture: venv
	$(BIN)/python docs/site/moving_picture.py

# Asks the servers of others, so that it fails where one of them is away; `make docs` checks all links of our own.
links: venv .venv/docs
	$(BIN)/python docs/site/build.py build/links linkcheck

soak: venv
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "soak and not alone" --timeout 0 --ignore=test/nodes --ignore=test/browser
	$(BIN)/python -m pytest -m "soak and alone" --timeout 0 --ignore=test/nodes --ignore=test/browser
	$(BIN)/python -m pytest -m soak --timeout 0 test/nodes test/browser

# 100 cases of each kind of file that is read, some 3 minutes on two cores; CASES=1000 SEED=1 for more, or the same again.
fuzz: venv
	PYTHONPATH=test/support $(BIN)/python -m fuzz.run $(if $(CASES),--cases $(CASES)) $(if $(SEED),--seed $(SEED))

fuzz-nodes: venv
	PYTHONPATH=test/support $(BIN)/python -m fuzz.nodes $(if $(MESSAGES),--messages $(MESSAGES)) $(if $(SEED),--seed $(SEED))

bench: venv
	$(BIN)/python benchmarks/costs/forward.py
	$(BIN)/python benchmarks/costs/inverse.py
	$(BIN)/python benchmarks/costs/projector.py
	$(BIN)/python benchmarks/costs/controllers.py
	$(BIN)/python benchmarks/costs/contact.py
	$(BIN)/python benchmarks/costs/biomechanics.py

against: venv
	$(BIN)/python benchmarks/against.py $(or $(BASE),HEAD)

imports: venv
	$(BIN)/python benchmarks/imports.py $(or $(BASE),HEAD)

$(COLCON_VENV)/pinned: requirements/colcon.txt .venv/pinned
	rm -rf $(COLCON_VENV) && $(BIN)/python -m venv $(COLCON_VENV)
	$(COLCON_VENV)/bin/python -m pip install --quiet --use-pep517 -r requirements/colcon.txt
	@touch $@

# A copy, so that colcon sees what a clone would hold; what it installed must then run, away from the checkout.
colcon: venv $(COLCON_VENV)/pinned
	rm -rf $(COLCON_WS) && mkdir -p $(COLCON_WS)/src/mbd_ros
	git ls-files -z --cached --others --exclude-standard | xargs -0 cp --parents -t $(COLCON_WS)/src/mbd_ros
	. $(COLCON_VENV)/bin/activate && cd $(COLCON_WS) && \
	test "$$(colcon list | cut -f 1,3)" = "$$(printf 'mbd_ros\t(ros.ament_python)')" && colcon build
	cd $(COLCON_WS)/install/mbd_ros && for name in $(NODES) mbd-ros; do \
	test -x lib/mbd_ros/$$name || exit 1; done \
	&& test -f share/ament_index/resource_index/packages/mbd_ros && test -f share/mbd_ros/package.xml \
	&& for folder in config launch; do diff -r ../../src/mbd_ros/$$folder share/mbd_ros/$$folder || exit 1; done \
	&& PYTHONPATH=$$(echo $$PWD/lib/python3*/site-packages) $(CURDIR)/$(BIN)/python lib/mbd_ros/mbd-ros \
	check share/mbd_ros/config/scenes/empty.yaml
	@echo "colcon: built as ros.ament_python, executables under lib/mbd_ros, the installed package runs"

clean:
	rm -rf .venv build install log dist demo_out report_out docs_out *.egg-info .mypy_cache .pytest_cache .ruff_cache
	find mbd_ros msg_adapters test launch -name __pycache__ -prune -exec rm -rf {} +

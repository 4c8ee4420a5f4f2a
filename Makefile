# The menu of the project: `make` alone prints it.
#
# Every target first makes what it needs, once: its part of a virtual environment in .venv, from the exact versions in
# requirements/. What runs the rig is the smallest part; tests, then website and notebook, add to it.
#   make PYTHON=python3.11 ...     use this interpreter instead of the first supported one
#   make test ROS=kilted           run the tests of the nodes on ROS 2 Kilted, in an environment of its own in build/

VENV := $(if $(filter kilted,$(ROS)),build/kilted-venv,.venv)
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:

# --- Which ROS 2: that of ROS=kilted, or a sourced Jazzy whose rclpy works, else the PyPI wheels ----------------------
ifeq ($(filter kilted,$(ROS))$(ROS_DISTRO),jazzy)
# an rclpy in an activated virtual environment is not a sourced one
SOURCED := $(shell $(or $(PYTHON),python3) -c 'import rclpy, sys; \
    sys.exit(sys.prefix != sys.base_prefix and rclpy.__file__.startswith(sys.prefix))' 2>/dev/null && echo yes)
endif

ifeq ($(SOURCED),yes)
ROS := sourced
# an apt-installed ROS registers pytest plugins of its own, which need not fit our pytest
export PYTEST_DISABLE_PLUGIN_AUTOLOAD := 1
PYTEST_PLUGINS_USED := -p pytest_timeout -p pytest_rerunfailures -p xdist.plugin -p _hypothesis_pytestplugin
else
ifeq ($(ROS),kilted)
ARGS ?= test/impact_rig/nodes test/impact_rig_studies/nodes
else
ROS := wheels
endif
export AMENT_PREFIX_PATH := $(CURDIR)/$(VENV)
# of another environment, or of another ROS, that make was called from
unexport PYTHONPATH PYTHONHOME RMW_IMPLEMENTATION CMAKE_PREFIX_PATH COLCON_PREFIX_PATH
ifneq ($(_ROS_WHEELS_BOOTSTRAP_COMPLETE)$(ROS_DISTRO),)
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH ROS_DISTRO
endif
endif
unexport VIRTUAL_ENV
# Container images set it. Every process would then compile all of its imports, most of the time of a short one.
unexport PYTHONDONTWRITEBYTECODE

# --- What everything that is started here sees ------------------------------------------------------------------------
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export ROS_DOMAIN_ID ?= 42
export ROS_LOG_DIR ?= $(CURDIR)/build/log
# A second thread of BLAS gains nothing on arrays as small as ours, and each process would begin and feed one.
export OPENBLAS_NUM_THREADS ?= 1
export MPLCONFIGDIR ?= $(CURDIR)/build/matplotlib

# --- Environment ------------------------------------------------------------------------------------------------------
# A stamp for each part: new versions are installed over the old ones, a new version or script of this package is only
# registered again. A copied or moved checkout needs a new environment, because it holds absolute paths.
STAMP := $(VENV)/has-$(ROS)$(subst /,_,$(PYTHON))
RUN := $(STAMP)-run
TEST := $(STAMP)-test
DOCS := $(STAMP)-docs
PACKAGE := $(VENV)/registered
ifneq ($(file <$(VENV)/made-in),$(CURDIR))
.PHONY: $(RUN) $(TEST) $(DOCS)
endif
INSTALL = @PYTHON='$(PYTHON)' requirements/venv.sh $(ROS) $(VENV)

$(RUN): requirements/run.txt requirements/$(ROS).txt
	$(INSTALL) run
	@touch $@

$(TEST): requirements/run.txt requirements/$(ROS).txt requirements/test.txt requirements/kernels.txt
	$(INSTALL) run test
	@test -e $(RUN) || touch $(RUN)
	@touch $@

$(DOCS): requirements/run.txt requirements/$(ROS).txt requirements/docs.txt
	$(INSTALL) run docs
	@test -e $(RUN) || touch $(RUN)
	@touch $@

$(PACKAGE): $(RUN) setup.py setup.cfg package.xml
	@requirements/kernels.sh $(VENV)
	@$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-input \
	    --no-deps --no-build-isolation --no-index --config-settings editable_mode=compat --editable .
	@touch $@

kernels: $(PACKAGE) ## build the library of compiled kernels if their sources have changed
	@requirements/kernels.sh $(VENV)

# --- Targets ----------------------------------------------------------------------------------------------------------
.PHONY: help kernels lab demo campaign docs site figures test check lint generate format bench fuzz journeys portability soak colcon adapters release venv lock clean

help: ## print this list
	@echo 'impact_rig: make TARGET, where TARGET is one of'
	@sed -nE 's/^([a-z]+):[^#]*## (.*)/  \1\t\2/p' $(firstword $(MAKEFILE_LIST)) | expand -t 14

lab: kernels ## start the live laboratory in the browser; ARGS=--sample plays back a short run
	@$(VENV)/bin/impact-rig lab $(ARGS)

demo: kernels ## measure the paper's five reductions through ROS topics, print and draw them
	@$(VENV)/bin/impact-rig demo $(ARGS)

campaign: kernels ## measure all points of the paper and write a report; ARGS='--only curves' measures a part
	@$(VENV)/bin/impact-rig campaign config/paper.yaml --check --output runs/campaign_paper $(ARGS); status=$$?; \
	    $(VENV)/bin/impact-rig report runs/campaign_paper && exit $$status

# A test that timed out waiting for another process is run once more, and the last line says so: real nodes on a busy
# machine may need very long. Nothing else is repeated.
SECOND_CHANCE := --reruns 1 --only-rerun WaitTimeoutError --only-rerun TimeoutExpired

# Files go to the workers in the order of test/conftest.py, the longest first; left to itself, xdist begins with the file
# of most tests and ends with those of a single long one. Of what a test takes half is waiting for other processes: two
# cores serve three workers. What starts no process only computes.
BY_FILE := --dist loadfile --no-loadscope-reorder --max-worker-restart 0

# How many seconds it took since `begin` is a figure of `make bench ONLY=start`.
note = mkdir -p build/start && echo $$(($$(date +%s) - begin)) > build/start/$(1)

# All tests end with the table of coverage; some of them would say nothing about it. The second table is of the files
# that hold compiled code, whose lines are seen where tests run them as plain Python.
COVERAGE := $(VENV)/bin/python -m coverage
LINES := IMPACT_RIG_LINES=$(CURDIR)/build/coverage/data PYTHONPATH=$(CURDIR)/tools/lines_passed$${PYTHONPATH:+:$$PYTHONPATH}
KERNELS = $$(grep -rl --include='*.py' '^from impact_rig.kernels import .*kernel\|^from impact_rig.kernels import .*entry' impact_rig | paste -sd,)
MEASURED := $(if $(ARGS),,1)

test: $(TEST) kernels ## run all tests on real ROS 2; ARGS=--changed or '-k codec' selects, SHUFFLE=7 changes the order
	@$(if $(MEASURED),mkdir -p build/coverage && $(COVERAGE) erase)
	@begin=$$(date +%s); IMPACT_RIG_REQUIRE_ROS=1 \
	    $(if $(MEASURED),$(LINES)) $(VENV)/bin/python -m pytest $(PYTEST_PLUGINS_USED) \
	    -n 3 $(BY_FILE) $(SECOND_CHANCE) $(if $(SHUFFLE),--shuffle=$(SHUFFLE)) $(ARGS); status=$$?; \
	    $(if $(MEASURED),$(COVERAGE) combine --quiet && $(COVERAGE) report && \
	    $(COVERAGE) report --include="$(KERNELS)" --fail-under=90 && [ $$status = 0 ] && $(call note,suite_s) &&) exit $$status

STYLE = $(VENV)/bin/ruff check . && $(VENV)/bin/ruff format --check .
LINT = $(VENV)/bin/mypy && $(VENV)/bin/lint-imports && $(VENV)/bin/python -m tools.prose_lint && \
    if command -v node >/dev/null; then for file in impact_rig_lab/static/*.js; do \
    node --check --input-type=module < $$file || exit 1; done; fi

# The slow part of lint runs next to the tests, because alone it would use one core only. What it rejects is printed last.
check: $(TEST) kernels ## quick checks after an edit: style, types, layers, tests without processes, browser and ROS
	@begin=$$(date +%s); $(STYLE) || exit; \
	    said=$$(mktemp); $$(command -v setsid) sh -c '$(LINT)' > $$said 2>&1 & lint=$$!; trap 'rm -f $$said' EXIT; \
	    trap 'kill -- -$$lint 2> /dev/null || kill $$lint; exit 130' INT TERM; \
	    $(VENV)/bin/python -m pytest $(PYTEST_PLUGINS_USED) -q -n 2 $(BY_FILE) --check $(ARGS); tests=$$?; \
	    wait $$lint; found=$$?; [ $$found = 0 ] || cat $$said; \
	    [ $$tests = 0 ] && [ $$found = 0 ] $(if $(MEASURED),&& $(call note,check_s))

lint: $(TEST) kernels ## check style, types, layers and prose
	@$(STYLE) && $(LINT)

generate: $(TEST) kernels ## rewrite the pages and files generated from the code
	@$(VENV)/bin/python -m tools.generate

journeys: $(TEST) kernels ## run every command of README and docs as a new user; ARGS=--cheap runs a few
	@$(VENV)/bin/python -m tools.journeys $(ARGS)

figures: $(TEST) kernels ## draw all figures of README and docs; ARGS='paper.svg lab_pictures' selects
	@$(VENV)/bin/python -m tools.figures $(ARGS)

docs: $(DOCS) kernels ## build the documentation as a website in build/site
	@$(VENV)/bin/python -m tools.website $(ARGS)

site: $(TEST) kernels ## build the rig as one web page in build/rig
	@$(VENV)/bin/python -m tools.browser_page $(ARGS)

format: $(TEST) $(PACKAGE) ## format the code
	@$(VENV)/bin/ruff check --fix-only .
	@$(VENV)/bin/ruff format .

bench: $(TEST) kernels ## measure the figures of docs/ and write build/bench.json; ONLY=physics measures one part
	@$(VENV)/bin/python -m benchmarks $(ONLY)

fuzz: $(TEST) kernels ## send 10,000 hostile inputs to each decoder and validator; ARGS='--inputs 1000 texts' selects
	@$(VENV)/bin/python -m fuzz $(ARGS)

portability: kernels ## compare bits under masked and emulated CPUs; ARGS=--write stores those of this machine
	@$(VENV)/bin/python -m qualification.portability $(ARGS)

soak: kernels ## run two hours of rig time free-running and ten minutes live; ARGS='--part live' selects
	@$(VENV)/bin/python -m qualification.soak $(ARGS)

COLCON := build/colcon-venv
$(COLCON)/ready: requirements/run.txt requirements/$(ROS).txt requirements/test.txt requirements/colcon.txt
	@PYTHON='$(PYTHON)' requirements/venv.sh $(ROS) $(COLCON) run test
	@$(COLCON)/bin/python -m pip install --quiet --disable-pip-version-check --no-input --requirement requirements/colcon.txt
	@touch $@

colcon: $(COLCON)/ready ## build, install, start and test with colcon from PyPI, as in a ROS workspace
	@$(if $(filter wheels,$(ROS)),AMENT_PREFIX_PATH='$(CURDIR)/$(COLCON)') \
	    $(COLCON)/bin/python qualification/check_colcon.py $(PYTEST_PLUGINS_USED) $(ARGS)

ADAPTERS := build/adapters-venv
$(ADAPTERS)/ready: requirements/run.txt requirements/$(ROS).txt requirements/adapters.txt
	@PYTHON='$(PYTHON)' requirements/venv.sh $(ROS) $(ADAPTERS) run
	@$(ADAPTERS)/bin/python -m pip install --quiet --disable-pip-version-check --no-input --requirement requirements/adapters.txt
	@touch $@

adapters: $(ADAPTERS)/ready kernels ## test examples/adapters with the real Gymnasium and LDAQ; RATTLESNAKE=DIR (a clone) adds it
	@$(if $(filter wheels,$(ROS)),AMENT_PREFIX_PATH='$(CURDIR)/$(ADAPTERS)') PYTHONPATH=$(CURDIR):$(CURDIR)/examples/adapters \
	    RATTLESNAKE='$(RATTLESNAKE)' IMPACT_RIG='$(CURDIR)/$(VENV)/bin/impact-rig' $(ADAPTERS)/bin/python -m pytest -c /dev/null -p no:cacheprovider -ra examples/adapters $(ARGS)

release: $(TEST) kernels ## build and check wheels and source distribution in build/release; ARGS=--try also installs them
	@$(VENV)/bin/python -m tools.release $(ARGS)

venv: $(TEST) $(DOCS) $(PACKAGE) ## set up the environment .venv with all its parts

lock: $(RUN) ## choose new versions of dependencies; ARGS=--check only checks the present ones
	@$(VENV)/bin/python requirements/lock.py $(ARGS)

clean: ## remove the environment, caches and build/, but no recorded runs elsewhere
	@rm -rf $(VENV) build install log *.egg-info .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	@find impact_rig impact_rig_studies impact_rig_lab test qualification tools benchmarks launch requirements -name __pycache__ -type d -prune -exec rm -rf {} +

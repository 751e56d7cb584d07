# `make` alone prints the targets. The environment in .venv is created on first use.
.DEFAULT_GOAL := help
SHELL := /bin/bash
WORLD ?= enhanced
SEED ?= 7
# Of demo: a map to drive in, made by slam or saved by `mazebot map save`.
MAP ?=
# `field=value` overrides of the world's recipe, separated by spaces.
SET ?=
GOAL ?= 0.5 -0.9 0.0
JSON ?= bench.json
# Of console.
PORT ?= 8080
HOURS ?= 1
# Any value: with the camera.
CAMERA ?=
# Of bench-nav: names of scenarios separated by spaces, seeds of each, any value for all of its seeds,
# figures to compare with, a settings file.
SCENARIO ?=
SEEDS ?=
FULL ?=
BASELINE ?=
SETTINGS ?=
# Of chaos: how often each fault is done, names of faults, any value: exploring, on bad links, in containers.
TIMES ?=
FAULT ?=
EXPLORE ?=
LINKS ?=
CONTAINERS ?=
# Of soak: minutes of a running stack, in place of an hour of simulated time.
MINUTES ?=
# Of fuzz: messages of each kind, seconds on a running stack, seconds for each kind of file, sequences of requests.
CASES ?=
STACK_S ?=
FILES_S ?= 20
SEQUENCES ?= 300
# A local uv if the machine has none; `python3` must then be version 3.11.
UV := $(shell command -v uv || echo .tools/bin/uv)
export UV_PYTHON_DOWNLOADS ?= automatic
# Without cached byte code, each process recompiles all its imports: a second and more.
unexport PYTHONDONTWRITEBYTECODE
# Its threads wait for work in a loop: 0.2 s of processor time in each process that starts.
export OPENBLAS_NUM_THREADS ?= 1
PYTHON := .venv/bin/python
comma := ,
space := $(subst ,, )
STAMP := .venv/.installed
# TELL TEXT COUNT COMMAND: nothing that takes long is silent.
TELL := scripts/with-progress.sh
# $(call sync,VENV,LOCK): the libraries of a lock file, and no others.
sync = $(TELL) "installing the libraries of $2" "scripts/count-installed.sh $(UV) $1 $2" \
	$(UV) pip sync --quiet --python $1/bin/python --require-hashes $2
SOURCES := services tests examples docker

.PHONY: help env demo slam demo-original up down goal recordings console view docs test test-slow test-longest test-ros2 test-browser test-compose check fix generate lock bench bench-nav bench-slam soak chaos fuzz seeds image clean

help: ## print the targets
	@awk -F':.*## ' '/^[a-z-]+:.*## /{printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

env: $(STAMP) ## create the environment in .venv (other targets do this by themselves)

.tools/bin/uv:
	@$(TELL) "no uv here: making an environment for it in .tools" "" python3 -m venv .tools
	@$(TELL) "installing uv into .tools" "" .tools/bin/python -m pip install --quiet --require-hashes -r requirements-tools.lock

$(STAMP): requirements-dev.lock requirements.lock pyproject.toml | $(filter .tools/bin/uv,$(UV))
	@test -x $(PYTHON) || $(TELL) "making the environment in .venv" "" $(UV) venv --quiet --python 3.11 .venv
	@$(call sync,.venv,requirements-dev.lock) --compile-bytecode
	@$(TELL) "installing mazebot itself" "" $(UV) pip install --quiet --python $(PYTHON) --no-deps --no-build-isolation --editable .
	@$(TELL) "compiling its byte code" "echo \$$(find services -name '*.pyc' | wc -l) files" $(PYTHON) -m compileall -q services
	@echo "compiling its kernels"
	@$(PYTHON) -m mazebot.embedded.kernels || true
	@touch $@

demo: $(STAMP) ## drive a tour in one process, no Docker (WORLD=enhanced SEED=7 SET=maze.seed=3 MAP=)
	@.venv/bin/mazebot demo --world $(WORLD) --seed $(SEED) $(SET:%=--set '%') $(MAP:%=--map '%') --out recordings/$$(date +%Y-%m-%d_%H-%M-%S)_$(WORLD)

slam: $(STAMP) ## explore a world without a map in one process (WORLD=enhanced SEED=7 SET=maze.seed=3)
	@.venv/bin/mazebot demo --slam --world $(WORLD) --seed $(SEED) $(SET:%=--set '%') --out recordings/$$(date +%Y-%m-%d_%H-%M-%S)_$(WORLD)_slam

demo-original: $(STAMP) ## the same tour in the original world
	@.venv/bin/mazebot demo --world original --seed $(SEED) --out recordings/$$(date +%Y-%m-%d_%H-%M-%S)_original

up: image ## start the containers of WORLD=enhanced|original|... and follow the tour
	@case "$(WORLD)" in \
		enhanced) docker compose up demo-world-enhanced;; \
		original) docker compose up demo-world;; \
		*) WORLD_NAME="$(WORLD)" WORLD_SET="$(subst $(space),$(comma),$(strip $(SET)))" docker compose up demo-world;; \
	esac

down: ## stop the containers and close their recordings
	@docker compose --profile original --profile enhanced --profile slam --profile slam-enhanced --profile simulator --profile simulator-enhanced --profile navigation-only --profile console --profile ros2 down

goal: $(STAMP) ## send the running robot to GOAL="x y yaw"
	@.venv/bin/mazebot goal $(GOAL)

recordings: $(STAMP) ## list the recorded runs
	@.venv/bin/mazebot recordings list

console: $(STAMP) ## serve the page with all runs and the live view at http://localhost:8080 (PORT=8080)
	@.venv/bin/mazebot console --port $(PORT) --open

view: $(STAMP) ## serve the newest recording, and open it in a browser if there is one
	@.venv/bin/mazebot recordings view --open

# Each file keeps its place, so that the links between pages are the same in the repository and in the site.
docs: .venv-docs/.installed ## build the site of all pages into site/ (no network), and fail for a broken link
	@rm -rf build/pages && mkdir -p build/pages
	@cp *.md CITATION.cff LICENSE build/pages
	@cp -r docs examples build/pages
	@NO_MKDOCS_2_WARNING=1 $(TELL) "building the site" "" .venv-docs/bin/mkdocs build --quiet --strict
	@echo "site/index.html: python3 -m http.server --directory site serves it"

.venv-docs/.installed: requirements-docs.lock | $(filter .tools/bin/uv,$(UV))
	@$(TELL) "making the environment in .venv-docs" "" $(UV) venv --quiet --allow-existing --python 3.11 .venv-docs
	@$(call sync,.venv-docs,requirements-docs.lock)
	@touch $@

test: $(STAMP) ## run the tests: no Docker, no network, no GPU
	@.venv/bin/pytest -n 2 --dist worksteal -m "not compose and not browser and not slow and not ros2"

# Those of the group `real_time` drive by the wall clock, or load the machine: never two at once.
test-slow: $(STAMP) .venv-fuzz/.installed ## run the long tests: every world driven, two hundred mazes
	@.venv/bin/pytest -n 2 --dist loadgroup --no-loadscope-reorder -m "slow and not longest"

# The same code in the same ways, with more cases: before a release, and after a change of the state's path.
test-longest: $(STAMP) ## run the long tests with all their cases, those of containers too (Docker)
	@.venv/bin/pytest -n 2 --dist loadgroup --no-loadscope-reorder -m "longest and not compose"
	@.venv/bin/pytest -n 0 -m "longest and compose" --timeout 900 tests/compose

# Not beside those of the containers: Chromium gives up what it loads when a network is made or removed.
test-browser: $(STAMP) ## run the tests of the console and the viewer in a browser (Chromium)
	@.venv/bin/pytest -n 2 --dist loadfile -m browser --timeout 900 tests/browser

# One after another: two stacks at once are more than two cores carry in real time.
test-compose: $(STAMP) ## run the tests of the containers (Docker)
	@.venv/bin/pytest -n 0 -m "compose and not longest" --timeout 900 tests/compose

test-ros2: $(STAMP) .venv-ros2/.installed ## run the tests against what others wrote for ROS 2: clients, type hashes
	@.venv/bin/pytest -n 2 --dist loadfile -m ros2

.venv-ros2/.installed: requirements-ros2.lock | $(filter .tools/bin/uv,$(UV))
	@$(TELL) "making the environment in .venv-ros2" "" $(UV) venv --quiet --clear --python 3.11 .venv-ros2
	@$(call sync,.venv-ros2,requirements-ros2.lock)
	@touch $@

check: $(STAMP) ## lint, check formats, types, imports and generated files
	@.venv/bin/ruff check $(SOURCES)
	@.venv/bin/ruff format --check $(SOURCES)
	@.venv/bin/mypy
	@.venv/bin/lint-imports
	@for page in access api topics recipes parameters recordings; do \
		.venv/bin/python -m mazebot.cli.pages.$${page}_page | diff - docs/$$page.md \
			|| { echo "docs/$$page.md is stale: make generate"; exit 1; }; \
	done
	@for schema in summary series labels; do \
		.venv/bin/python -m mazebot.cli.pages.run_schemas $$schema | diff - docs/schemas/$$schema.schema.json \
			|| { echo "docs/schemas/$$schema.schema.json is stale: make generate"; exit 1; }; \
	done
	@made=$$(mktemp -d) && .venv/bin/python -m mazebot.cli.pages.ros_package $$made/msgs \
		&& diff -r $$made/msgs ros2/mazebot_msgs && rm -r $$made \
			|| { echo "ros2/mazebot_msgs is stale: make generate"; exit 1; }
	@echo "check: all well"

fix: $(STAMP) ## format, and fix what the linter can
	@.venv/bin/ruff check --fix $(SOURCES)
	@.venv/bin/ruff format $(SOURCES)

generate: $(STAMP) ## regenerate the generated files
	@for page in access api topics recipes parameters recordings; do \
		.venv/bin/python -m mazebot.cli.pages.$${page}_page > docs/$$page.md; \
	done
	@for schema in summary series labels; do \
		.venv/bin/python -m mazebot.cli.pages.run_schemas $$schema > docs/schemas/$$schema.schema.json; \
	done
	@.venv/bin/python -m mazebot.cli.pages.ros_package ros2/mazebot_msgs
	@.venv/bin/python -m mazebot.recorder.foxglove.layout > .layout.json \
		&& mv .layout.json services/mazebot/recorder/foxglove/layout.json
	@.venv/bin/python -m mazebot.embedded.observed_kernels > .kernels.txt \
		&& mv .kernels.txt services/mazebot/embedded/kernels.txt

lock: $(STAMP) ## resolve the dependencies again
	@$(UV) pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-header --no-annotate --no-emit-index-url pyproject.toml -o requirements.lock
	@$(UV) pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-header --no-annotate --no-emit-index-url --extra dev -c requirements.lock pyproject.toml -o requirements-dev.lock
	@$(PYTHON) -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["docs"], sep="\n")' \
		| $(UV) pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-header --no-annotate --no-emit-index-url - -o requirements-docs.lock
	@$(PYTHON) -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["dependency-groups"]["ros2"], sep="\n")' \
		| $(UV) pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-header --no-annotate --no-emit-index-url - -o requirements-ros2.lock
	@$(PYTHON) -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["dependency-groups"]["bridge"], sep="\n")' \
		| $(UV) pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-header --no-annotate --no-emit-index-url -c requirements.lock - -o requirements-bridge.lock
	@echo 'uv' | $(UV) pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-header --no-annotate --no-emit-index-url - -o requirements-tools.lock
	@echo 'cyclonedx-bom==7.5.0' | $(UV) pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-header --no-annotate --no-emit-index-url - -o requirements-sbom.lock
	@echo 'ir-sim==2.12.0' | $(UV) pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-header --no-annotate --no-emit-index-url - -o requirements-bench.lock
	@echo "atheris==3.0.0 ; sys_platform == 'linux' and platform_machine == 'x86_64'" \
		| $(UV) pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-header --no-annotate --no-emit-index-url - -o requirements-fuzz.lock

bench: $(STAMP) ## measure speed and memory, beside PyBullet and ir-sim (JSON=bench.json)
	@$(MAKE) --silent .venv-bench/.installed || echo "ir-sim cannot be had: its rows stay empty"
	@.venv/bin/python -m mazebot.bench.whole.bench --json $(JSON)

.venv-bench/.installed: requirements-bench.lock | $(filter .tools/bin/uv,$(UV))
	@$(TELL) "making the environment in .venv-bench" "" $(UV) venv --quiet --allow-existing --python 3.11 .venv-bench
	@$(call sync,.venv-bench,requirements-bench.lock)
	@touch $@

soak: $(STAMP) $(if $(MINUTES),$(if $(CONTAINERS),image)) ## drive an hour of simulated time to random goals (HOURS=1 SEED=7 WORLD=enhanced CAMERA=), or a running stack, killing a service each minute (MINUTES=30 CONTAINERS=1)
ifdef MINUTES
	@.venv/bin/python -m mazebot.bench.chaos.soak --minutes $(MINUTES) --seed $(SEED) $(if $(CONTAINERS),--containers) \
		--json $(if $(filter file,$(origin JSON)),soak.json,$(JSON))
else
	@.venv/bin/python -m mazebot.bench.whole.soak --hours $(HOURS) --seed $(SEED) --world $(WORLD) $(if $(CAMERA),--camera)
endif

chaos: $(STAMP) $(if $(CONTAINERS),image) ## kill, freeze and cut off services while the robot drives (SEED=7 TIMES=1 FAULT=kill-physics EXPLORE=1 LINKS=1 CONTAINERS=1)
	@.venv/bin/python -m mazebot.bench.chaos --seed $(SEED) $(TIMES:%=--times %) $(FAULT:%=--fault %) \
		$(if $(EXPLORE),--explore) $(if $(LINKS),--links) $(if $(CONTAINERS),--containers) --plot chaos.png --json $(if $(filter file,$(origin JSON)),chaos.json,$(JSON))

# What one part finds does not keep the others from being run.
fuzz: $(STAMP) ## give malformed messages to every topic, query and service, and to a running stack, malformed files to what reads them (SEED=7 CASES=100000 STACK_S=60 FILES_S=20 SEQUENCES=300)
	@$(MAKE) --silent .venv-fuzz/.installed || echo "atheris cannot be had: files are changed without looking at what they reach"
	@found=0; \
	.venv/bin/python -m mazebot.bench.fuzz --seed $(SEED) $(CASES:%=--cases %) $(STACK_S:%=--seconds %) \
		--json $(if $(filter file,$(origin JSON)),fuzz.json,$(JSON)) || found=1; \
	.venv/bin/python -m tests.fuzz --seed $(SEED) --seconds $(FILES_S) || found=1; \
	SEQUENCES=$(SEQUENCES) .venv/bin/pytest -n 0 tests/sequences || found=1; \
	exit $$found

.venv-fuzz/.installed: requirements-fuzz.lock | $(filter .tools/bin/uv,$(UV))
	@$(TELL) "making the environment in .venv-fuzz" "" $(UV) venv --quiet --allow-existing --python 3.11 .venv-fuzz
	@$(call sync,.venv-fuzz,requirements-fuzz.lock)
	@touch $@

seeds: $(STAMP) ## drive the tour of both worlds over ten seeds
	@.venv/bin/python -m mazebot.bench.whole.seeds

bench-nav: $(STAMP) ## drive many scenarios, judged by the ground truth (SCENARIO=tours SEED=0 SEEDS=5 FULL= BASELINE=old.json)
	@.venv/bin/python -m mazebot.bench.navigation $(SCENARIO:%=--scenario %) \
		$(if $(filter file,$(origin SEED)),,--seed $(SEED)) $(SEEDS:%=--seeds %) $(if $(FULL),--full) \
		$(BASELINE:%=--baseline %) $(SETTINGS:%=--settings %) --plots bench-nav \
		--json $(if $(filter file,$(origin JSON)),bench-nav.json,$(JSON))

bench-slam: $(STAMP) ## explore worlds without a map, judged by the ground truth (WORLDS="original maze" SEED=1 SEEDS=5 SLIP=0.1 NOISE=0.05)
	@.venv/bin/python -m mazebot.bench.slam.slam_bench $(WORLDS:%=--world %) \
		$(if $(filter file,$(origin SEED)),,--seed $(SEED)) $(SEEDS:%=--seeds %) $(SLIP:%=--slip %) \
		$(NOISE:%=--noise %) --json $(if $(filter file,$(origin JSON)),bench-slam.json,$(JSON))

image: ## build the container image
	@docker compose build demo-world-enhanced

clean: ## remove the environment and caches; recordings stay
	@rm -rf .venv .venv-bench .venv-docs .venv-ros2 .tools build site .mypy_cache .ruff_cache .pytest_cache .hypothesis .cydr_cache .import_linter_cache
	@find services tests examples -name __pycache__ -type d -prune -exec rm -rf {} +

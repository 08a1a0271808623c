# Everything a newcomer types. Each target makes .venv by itself; nothing outside this directory changes,
# but for a user-mode kernel in ~/.cache/hilrig (make test-vcan, where this machine's kernel has no CAN).

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
RUN := runs/make-run
# A test process a core, and two that work while others wait for a process, a link or the clock; each imports everything first.
WORKERS := $(shell n=$$(env -u OMP_NUM_THREADS nproc 2>/dev/null || echo 2); echo $$((n + 2)))

# Images that forbid bytecode make every process of ours start in seconds instead of tenths.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: pins help run test .types .rules .tests check .changed test-slow test-hostile sbom wheel mutations test-vcan .vcan-virtual .vcan-real bench figures compiled test-compiled pictures docs clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

run: $(INSTALLED) ## the networked DC motor in real time for 10 s; says where log and report lie
	@mkdir -p runs
	$(BIN)/hil run dc-motor-hinf --clock real --link can:hil:rig0 --duration 10 -o $(RUN).mcap --force
	@$(BIN)/hil report $(RUN).mcap -o $(RUN).html >/dev/null
	@echo
	@echo "log     $(CURDIR)/$(RUN).mcap"
	@echo "report  file://$(CURDIR)/$(RUN).html"

# One thread of linear algebra per test process: there are as many processes as cores.
test: export OMP_NUM_THREADS = 1
test: $(INSTALLED) ## lint, types, import rules, tests and doctests, in virtual and in real time
	$(BIN)/ruff check
	@$(MAKE) --no-print-directory -j3 .types .rules .tests

.types:
	$(BIN)/mypy

.rules:
	@out=$$($(BIN)/lint-imports) || { echo "$$out"; exit 1; }

.tests:
	$(BIN)/pytest -n $(WORKERS) --dist worksteal $(PYTEST_ARGS)

check: export OMP_NUM_THREADS = 1
check: $(INSTALLED) ## lint, types, import rules, and the fast tests of what changed since main
	$(BIN)/ruff check
	@$(MAKE) --no-print-directory -j3 .types .rules .changed

.changed:
	@tests=$$($(BIN)/python -m tests.changed) || exit; [ -z "$$tests" ] && echo "no tests of what changed" || \
	    $(BIN)/pytest -n $(WORKERS) --dist worksteal -m "not realtime" $(PYTEST_ARGS) $$tests

test-slow: export OMP_NUM_THREADS = 1
test-slow: $(INSTALLED) ## the long computations: whole chapters, studies of hundreds of loops; an hour or so
	$(BIN)/pytest -n auto --dist worksteal --hil-slow -m "slow and not realtime" $(PYTEST_ARGS)
	$(BIN)/pytest -n 0 --hil-slow -m "slow and realtime" $(PYTEST_ARGS)

mutations: $(INSTALLED) ## put every known fault in and see its tests fail (a quarter of an hour)
	$(BIN)/python -m tests.mutations $(MUTATIONS)

# Only the files with vcan tests: importing all the others inside a user-mode kernel takes longer than the tests.
VCAN_TESTS = $(shell grep -rlE --include='test_*.py' '(^pytestmark = |^@|marks=)pytest\.mark\.vcan' tests)
PYTEST_VCAN = $(BIN)/python -m pytest --hil-require=vcan -p no:cacheprovider

test-vcan: $(INSTALLED) ## the tests that need a real vcan0, in this kernel or a user-mode one (built the first time)
	@if $(BIN)/hil vcan --install --virtual-time -- true; then $(MAKE) --no-print-directory .vcan-virtual; else \
	    echo "no virtual time here: the tests that need it are skipped"; \
	    $(MAKE) --no-print-directory .vcan-real VCAN=vcan; fi

.vcan-virtual:
	$(BIN)/hil vcan --install -v --virtual-time --timeout 600 -- $(PYTEST_VCAN) -m "vcan and not realtime" $(VCAN_TESTS)
	@$(MAKE) --no-print-directory .vcan-real VCAN="vcan and realtime" VCAN_TESTS="$$(grep -l 'mark\.realtime' $(VCAN_TESTS))"
	$(BIN)/pytest -n 2 --hil-require=vcan tests/vcan/test_runner.py tests/vcan/test_repeatable_sessions.py

.vcan-real:
	$(BIN)/hil vcan --install -v --timeout 600 -- $(PYTEST_VCAN) -m "$(VCAN)" $(VCAN_TESTS)

test-hostile: export OMP_NUM_THREADS = 1
test-hostile: $(INSTALLED) ## all attacks at length, a million inputs among them; writes their table into the guide; an hour
	@rm -rf runs/hostile
	-$(ATTACKS)/virtual.xml -n $(WORKERS) --dist worksteal -m "not realtime" $(filter-out tests/vcan/%,$(ATTACKED))
	-$(ATTACKS)/real.xml -n 0 -m realtime $(filter-out tests/vcan/%,$(ATTACKED))
	@if $(BIN)/hil vcan -- true 2>/dev/null; then $(ATTACKS)/vcan.xml -n 2 --hil-require=vcan $(filter tests/vcan/%,$(ATTACKED)); fi
	$(BIN)/python -m tests.hostile.table page runs/hostile/*.xml
ATTACKED = $(shell $(BIN)/python -m tests.hostile.table files)
ATTACKS = $(BIN)/pytest --hil-hostile -o junit_suite_name=$$(git describe --always --dirty) $(PYTEST_ARGS) --junitxml runs/hostile

# The tool has an environment of its own, held to hashes like the other: it lists ours and stands not in it.
SBOM := .venv-sbom/bin
sbom: $(INSTALLED) ## bill of materials of what is installed, CycloneDX 1.6, in runs/sbom.json
	@$(SBOM)/cyclonedx-py --version >/dev/null 2>&1 || { $(PYTHON) -m venv --clear .venv-sbom && \
	    $(SBOM)/python -m pip install -q --disable-pip-version-check --require-hashes --no-deps -r .ci/sbom.txt; }
	@mkdir -p runs
	@$(SBOM)/cyclonedx-py environment $(BIN)/python --pyproject pyproject.toml --spec-version 1.6 --output-reproducible \
	    --mc-type application -o runs/sbom.json
	@echo "bill of materials  $(CURDIR)/runs/sbom.json"

wheel: $(INSTALLED) ## wheel and source archive in dist/, each tried in a bare environment with every Python that is here
	@.ci/smoke

pins: $(INSTALLED) ## choose the versions again and write their hashes: constraints.txt, .ci/*.txt
	$(BIN)/uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --extra test \
	    pyproject.toml -o constraints.txt
	for each in "build: hatchling==1.33.0 editables pip uv" "docs: sphinx>=8.1 myst-parser>=4 furo>=2024.8" "sbom: cyclonedx-bom"; do \
	    printf '%s\n' $${each#*:} | $(BIN)/uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-header \
	        --no-annotate --allow-unsafe -c constraints.txt - -o .ci/$${each%%:*}.txt || exit 1; done

bench: $(INSTALLED) ## timing beside cyclictest, round trips of all links
	$(BIN)/hil bench timing
	$(BIN)/hil bench links

# Of both forms of the loop where there is a C compiler; beside the version of `--before` where git has it.
figures: $(INSTALLED) ## measure every figure of speed, make the guide's page of them: some 20 minutes, quiet
	@rm -rf runs/bench && mkdir -p runs/bench
	@if command -v cc >/dev/null; then $(MAKE) --no-print-directory compiled; else rm -rf runs/compiled; fi
	@if git cat-file -e $(BEFORE) 2>/dev/null; then mkdir runs/bench/before && git archive $(BEFORE) | tar -x -C runs/bench/before && \
	    $(BIN)/python -m compileall -q runs/bench/before/hil runs/bench/before/plants runs/bench/before/transport runs/bench/before/design; fi
	$(BIN)/python -m tests.bench all --json $$([ -d runs/compiled ] && echo --compiled runs/compiled) \
	    $$([ -d runs/bench/before ] && echo --before runs/bench/before) $(BENCH_ARGS) > runs/figures.json
	@cp runs/figures.json hil/guide/figures-$(CPU_KIND).json
	$(BIN)/python -m tests.bench page hil/guide/figures-*.json -o hil/guide/figures.md
	@grep -qx figures hil/guide/index.md || sed -i 's/^performance$$/performance\nfigures/' hil/guide/index.md
BEFORE := 3aeb887
CPU_KIND = $(or $(shell sed -n 's/^vendor_id[[:space:]]*: //p' /proc/cpuinfo 2>/dev/null | head -1),$(shell uname -m))

compiled: $(INSTALLED) ## the wheel with the loop compiled, unpacked in runs/compiled: some two minutes of CPU time
	@rm -rf runs/compiled runs/compiled-wheel && mkdir -p runs
	@HILRIG_COMPILE=1 $(BIN)/hatchling build -t wheel -d runs/compiled-wheel >runs/compiled.log 2>&1 || { cat runs/compiled.log; exit 1; }
	@$(BIN)/python -m zipfile -e runs/compiled-wheel/*.whl runs/compiled && $(BIN)/python -m compileall -q runs/compiled
	@rm -rf runs/compiled-wheel && echo "loop compiled  $(CURDIR)/runs/compiled"

test-compiled: export OMP_NUM_THREADS = 1
test-compiled: compiled ## the tests in virtual time with the loop compiled, in runs/compiled
	@cp -r tests README.md README.png CONTRIBUTING.md CHANGELOG.md Makefile pyproject.toml constraints.txt LICENSE hatch_build.py \
	    .ci runs/compiled && cp hil/guide/*.png runs/compiled/hil/guide
	@cd runs/compiled && PYTHONPATH=$$PWD $(CURDIR)/$(BIN)/python -c 'from hil.log.write.provenance import loop_form as form; \
	    assert form() == "compiled", form()'
	cd runs/compiled && PYTHONPATH=$$PWD $(CURDIR)/$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -p no:cacheprovider \
	    -m "not realtime" $(PYTEST_ARGS) $(or $(TESTS),tests)

pictures: $(INSTALLED) ## the pictures of README and guide, by Chromium
	$(BIN)/python -m tests.pictures hil/guide README.png

# Sphinx is wanted by nobody but this target: it is installed when it is first asked for.
docs: $(INSTALLED) ## the guide as a site with a gallery of all experiments, in runs/docs
	@$(BIN)/python -c 'import sphinx, myst_parser, furo' 2>/dev/null || \
	    $(PIP) --require-hashes --no-deps -r .ci/docs.txt
	@rm -rf runs/guide && mkdir -p runs && cp -r hil/guide runs/guide && $(BIN)/python -m tests.gallery runs/guide
	@sed -i 's/^figures$$/figures\ngallery/' runs/guide/index.md
	$(BIN)/python -m sphinx -q -W -b html -c .ci/guide runs/guide runs/docs
	@echo "guide  file://$(CURDIR)/runs/docs/index.html"

clean: ## remove .venv, runs and caches (not ~/.cache/hilrig)
	rm -rf .venv .venv-sbom runs dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Every package has a hash that is checked, what builds and installs included (.ci/build.txt: pip, uv, hatchling): nothing is fetched
# for a build, and nothing comes that stands in no list. Only the pip that Python itself brings is taken as it is. uv for speed;
# where it does not run, plain pip does the same, with the same hashes, slower.
PIP := $(BIN)/python -m pip install -q --disable-pip-version-check
$(INSTALLED): pyproject.toml constraints.txt .ci/build.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	    echo "Python 3.11 or newer is needed; $(PYTHON) is $$($(PYTHON) -V 2>&1). Another one: make PYTHON=python3.12"; exit 1; }
	@$(BIN)/python -c '' 2>/dev/null || $(PYTHON) -m venv --clear .venv || { \
	    echo "$(PYTHON) -m venv failed; on Debian: apt-get install python3-venv"; exit 1; }
	@echo "installing into .venv (once): 119 packages, 1.1 GB on disk, each held to its hash"
	@$(PIP) --require-hashes --no-deps -r .ci/build.txt
	@if $(BIN)/uv --version >/dev/null 2>&1; then \
	   install="$(BIN)/uv pip install -q --python $(BIN)/python --compile-bytecode"; \
	 else install="$(PIP)"; fi; \
	 $$install --require-hashes --no-deps -r constraints.txt && $$install --no-deps --no-build-isolation -e .
	@$(BIN)/python -m pip check --disable-pip-version-check >/dev/null || { \
	    $(BIN)/python -m pip check --disable-pip-version-check; \
	    echo "a package of pyproject.toml stands in no list of hashes: add it to constraints.txt (make pins)"; exit 1; }
	@touch $@

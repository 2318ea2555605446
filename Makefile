# make fly   sets up a virtual environment and flies the figure eight
# make test  sets it up and runs the tests, except for the long ones; TESTS="-m long" runs those, TESTS="-m 'not slow'" the
#            quick ones, and TESTS= all
# make fuzz  reads and flies ten thousand mutated scenarios, a hundred structures in compiled diagrams, and thousands of
#            mutated logs
# make rooms  plans a hundred random rooms, or proves that there is no route
# make passages  compares the passages that are chosen with random ones
# make paper  flies the paper's experiment again and writes a report
# make controllers  flies all controllers in all laboratories and writes a report; TUNE=1 tunes them anew before
# make lint  checks style, spelling and types
# make docs  builds the pages and the reference in out/docs
# make benchmark  measures speed
# make mutants  changes 40 places of each package, one at a time, and demands that tests notice 95 % of them; takes hours;
#               MUTANTS=100 or all, SEED=1 for other places, ONLY="space/ gym/" for some packages
# make figures  draws again what the docs show

VENV ?= .venv
PYTHON ?= $(firstword $(shell .ci/pythons))
PIP = $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

# Scenarios whose diagrams are drawn in diagrams/drawings
DRAWN = figure_eight hover slalom laboratory:low_wind neural_fly:wind_8 onboard outdoor robustness \
	paper:low_wind_pd_t2fnn crazyswarm2:log08 nanobench forest bad_day:racer upset indoor_flow \
	outdoor_gnss warehouse_uwb betaflight

# Tests that are run
TESTS ?= -m "not long"

# Mutants of each package, drawn evenly over its lines
MUTANTS ?= 40
SEED ?= 0
ONLY ?=

.PHONY: fly test fuzz rooms passages paper controllers lint docs benchmark mutants figures

fly: $(VENV)/.installed
	$(VENV)/bin/drake-quad fly figure_eight

# Tests start many processes: what one has compiled, the others need not.
test: export PYTHONDONTWRITEBYTECODE =
test: $(VENV)/.installed-test
	$(VENV)/bin/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder $(TESTS)

fuzz: $(VENV)/.installed-test
	FUZZ_CASES=10000 $(VENV)/bin/python -m pytest tests/scenario/test_fuzz.py tests/compilation/test_compiled_scenarios.py
	FUZZ_CASES=500 $(VENV)/bin/python -m pytest tests/logs/test_logs_fuzz.py

rooms: $(VENV)/.installed-test
	ROOMS=100 $(VENV)/bin/python -m pytest --numprocesses auto tests/space/test_rooms.py

passages: $(VENV)/.installed-test
	RESTARTS=100 $(VENV)/bin/python -m pytest --numprocesses auto -rP tests/space/test_restarts.py

paper: $(VENV)/.installed
	$(VENV)/bin/drake-quad replicate

controllers: $(VENV)/.installed
	$(if $(TUNE),$(VENV)/bin/drake-quad judge --tune)
	$(VENV)/bin/drake-quad judge

lint: $(VENV)/.installed-lint
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/codespell
	$(VENV)/bin/mypy

docs: $(VENV)/.installed-docs
	$(VENV)/bin/python -m sphinx --jobs auto --fail-on-warning --keep-going --quiet docs out/docs

benchmark: $(VENV)/.installed
	$(VENV)/bin/python scripts/benchmark.py

mutants: $(VENV)/.installed-test
	$(VENV)/bin/python tests/mutants/run.py --number $(MUTANTS) --seed $(SEED) $(if $(ONLY),--only $(ONLY))

figures: $(VENV)/.installed $(VENV)/.installed-docs
	$(VENV)/bin/drake-quad plan slalom
	cp out/slalom/plan.png docs/pictures/slalom.png
	$(VENV)/bin/drake-quad plan forest
	cp out/forest/plan.png docs/pictures/forest_plan.png
	$(VENV)/bin/drake-quad replay forest --samples 1 --output out/forest_replay \
		--controller controllers/lqg:lqg_robustness --controller controllers/designed/robustness:indi_t2fnn
	$(VENV)/bin/python tests/visualization/browser.py out/forest_replay/replay.html 9 docs/pictures/forest.png \
		3.2 -3.6 4.6 -0.6 -0.6 0.6
	$(VENV)/bin/python scripts/development/forest_margins.py
	cp out/forest_margins/forest_margins.png out/forest_margins/forest_margins.csv docs/pictures
	$(VENV)/bin/drake-quad fly laboratory:low_wind
	cp out/low_wind/wind.png docs/pictures/wind.png
	$(VENV)/bin/drake-quad replay laboratory:high_wind --samples 1 --output out/front \
		$(foreach name,lqg indi pd,--controller controllers/designed/laboratory:$(name))
	$(VENV)/bin/python tests/visualization/browser.py out/front/replay.html 19 docs/pictures/replay.png
	$(VENV)/bin/python tests/visualization/browser.py out/front/replay.html 7.5:13.5 docs/pictures/replay.webp
	rm -rf out/falsify/page
	$(VENV)/bin/drake-quad falsify robustness --controller controllers/designed/robustness:lqg --minimize near \
		--set "requirements={near: {always: {signal: position_error, below: 0.5}}}" --output out/falsify/page
	cp out/falsify/page/worst.png docs/pictures/worst_case.png
	$(VENV)/bin/python scripts/development/certified_scales.py
	cp out/certified_scales/certified_scales.png out/certified_scales/certified_scales.csv docs/pictures
	$(VENV)/bin/python scripts/development/compare_sensors.py
	cp out/compare_sensors/compare_sensors.png docs/pictures
	$(MAKE) $(VENV)/.installed-betaflight
	$(VENV)/bin/python scripts/development/compare_firmware.py
	cp out/compare_firmware/compare_firmware.png docs/pictures
	$(VENV)/bin/drake-quad map upset --vary initial.attitude.0 -3.1415 3.1415 --vary initial.body_rates.0 -20 20 \
		--metric settling_time --size 24 --output out/recovery \
		$(foreach name,pd pid disturbance_observer l1 indi indi_fast geometric lqg, \
			--controller controllers/designed/laboratory:$(name)) \
		$(foreach name,pd pid pd_t2fnn,--controller controllers/paper:$(name)) --controller controllers/raptor:raptor_plus
	cp out/recovery/field_map.png docs/pictures/recovery.png
	$(VENV)/bin/drake-quad map laboratory:nominal
	cp out/stability/nominal/position_map.png docs/pictures/stability.png
	$(VENV)/bin/drake-quad compare
	cp out/comparison/comparison.png docs/pictures/comparison.png
	$(VENV)/bin/drake-quad identify tests/data/crazyflie/crazyswarm2/log100.xz --mass 0.0375
	cp out/identified/log100/fit.png docs/pictures/identification.png
	$(VENV)/bin/drake-quad compare-log tests/data/crazyflie/crazyswarm2/log100.xz crazyswarm2:log100
	cp out/compare_log/log100_log100/comparison.png docs/pictures/log_comparison.png
	rm -rf out/monte_carlo/robustness
	$(VENV)/bin/drake-quad study $(foreach name,pd pd_t1fnn pd_t2fnn pd_feed_forward, \
		--controller controllers/paper:$(name))
	cp out/monte_carlo/robustness/distribution.png docs/pictures/robustness.png
	$(VENV)/bin/python scripts/development/document_scenarios.py --output docs/reference
	$(VENV)/bin/python scripts/development/run_notebooks.py --output docs/notebooks
	rm -rf diagrams/drawings
	for scenario in $(DRAWN); do \
		$(VENV)/bin/drake-quad draw $$scenario --output diagrams/drawings/$${scenario##*:} || exit; done
	$(VENV)/bin/python scripts/development/calibrate_paper.py
	cp out/calibration/calibration.csv drake_quad/replication
	$(VENV)/bin/drake-quad replicate
	cp -r $(addprefix out/paper/,report.md report.html figures table_ii.csv table_ii.md claims.csv fair.csv effort.csv) docs/replication
	$(VENV)/bin/drake-quad judge
	mkdir -p docs/controllers
	cp -r $(addprefix out/controllers/,report.md report.html figures summary.csv answers.csv) docs/controllers

$(VENV)/bin/python:
	@test -n "$(PYTHON)" || { echo "no Python from 3.11 on was found on PATH or under pyenv"; exit 2; }
	@echo "setting up $(VENV) with $(PYTHON); this takes a minute or two"
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(VENV)/bin/python pyproject.toml constraints.txt
	$(PIP) --editable .
	@touch $@

$(VENV)/.installed-%: $(VENV)/.installed
	$(PIP) --editable ".[$*]"
	@touch $@

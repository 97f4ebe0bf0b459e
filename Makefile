# seatrial: `make demo`, `make test`, `make slow`, `make check`, `make published`, `make bench`;
# each sets up .venv by itself, `make ray` another one, .venv-ray.
# PYTHON=... names another interpreter, SEATRIAL_DATA=... the folder of outside data (else
# ../shared/data where it exists), which `make test` leaves alone.

.PHONY: demo robustness coverage bands docking manoeuvring next benchmark readme published bench dist docs gallery test test-data slow nightly nightly-tests ray abuse check ruff mypy imports clean help
.DELETE_ON_ERROR:

VENV := .venv
BIN := $(VENV)/bin
# Ray's plugin and joblib ask for different versions of cloudpickle: two environments.
RAY := .venv-ray

# Relative on purpose: pip splits these variables at spaces. Both names, because pip 25.3 and
# later look at the second one for isolated builds.
export PIP_CONSTRAINT := constraints.txt
export PIP_BUILD_CONSTRAINT := constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# The suites start hundreds of processes: each would compile every module again.
unexport PYTHONDONTWRITEBYTECODE

# Files of tests run side by side; the tests of one stay together, for they share what they prepare.
WORKERS := 2
PYTEST = $(BIN)/python -m pytest --numprocesses $(WORKERS) --dist loadfile -p no:benchmark

# Small matrices: a second BLAS thread costs more than it brings.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1

ifeq ($(origin SEATRIAL_DATA),undefined)
ifneq ($(wildcard ../shared/data/.),)
export SEATRIAL_DATA := $(CURDIR)/../shared/data
endif
endif

help:
	@echo 'make demo    a sweep of 183 runs on the milliAmpere ferry, its tables and its figures'
	@echo 'make robustness   every identifier on four vessels and the recordings, SEEDS=20 each; docs/identification.md'
	@echo 'make manoeuvring turning circles after simulated trials, TRIAL_SEEDS=20'
	@echo 'make next    simulated trials of seatrial next, SEEDS=20; docs/howto/next.md'
	@echo 'make coverage   how many true coefficients the 95 % intervals cover, COVERAGE_SEEDS=100; docs/identification.md'
	@echo 'make bands      what was measured in the bands of predictions, on data left out; docs/identification.md'
	@echo 'make docking  three vessels into their berths with nominal, identified and true models, SEEDS=20; docs/docking.md'
	@echo 'make benchmark   every entrant on the tasks of conf/benchmark: results/benchmark/index.html, docs/benchmark.md'
	@echo 'make docs    the guide as pages in site, built strictly and without a network; make gallery: its figures alone'
	@echo 'make test    the test suite without outside data; make test-data: the tests that need them'
	@echo 'make slow    the tests that take longer, with outside data where there are any'
	@echo 'make nightly what takes hours: $(NIGHTLY); it goes on after a failure'
	@echo 'make ray     the tests of Ray, in .venv-ray'
	@echo 'make abuse   20 kills, writers at once, full disks; a part of it is in make slow'
	@echo 'make check   ruff, mypy --strict, and imports that do not resolve (basedpyright)'
	@echo 'make published  every published experiment, and a page of printed figures beside ours'
	@echo 'make bench   what a user would pick instead, measured beside ours: results/bench.json, docs/speed.md'
	@echo 'make dist    the source distribution and the wheel, as PyPI would take them (twine check)'
	@echo 'make clean   remove .venv, .venv-ray and the caches (results stay)'

# No identification, the thesis's and ours. Without noise one seed is enough.
THESIS := identifier=plsr identifier.force=commanded identifier.selection=test \
    identifier.inertia_factor=null identifier.lowpass_hz=null identifier.bootstrap=null
NOISY := disturbance=noise,[constant,noise],[wind,noise] seed=range(0,20)
demo: $(VENV)/demo.stamp
	$(BIN)/python -m runner -m --variant 'identifier=none,auto disturbance=calm seed=0' \
	    --variant '$(THESIS) disturbance=calm seed=0' --variant 'identifier=none,auto $(NOISY)' \
	    --variant '$(THESIS) $(NOISY)' deploy_unphysical=true hydra/launcher=processes
	$(BIN)/python -m runner.compare table --metric e_pos_mae --statistic median,n --baseline identifier=none
	$(BIN)/python -m runner.compare table --metric velocity_rmse_restarts --dof sway --statistic median,n \
	    --baseline identifier=none
	for figure in 'bars --metric e_pos_mae' orders residual track errors coefficients; do \
	    $(BIN)/python -m runner.compare plot $$figure || exit 1; \
	done

# Every identifier on four vessels and the supplied recordings. Two vessels have no wind, and
# are given true coefficients that differ from the nominal ones. Where nothing is random, one seed
# is enough; of the Beluga five, since a search takes minutes. A run that fails or diverges (exit code
# 1) is kept, and counted in the tables.
SEEDS := 20
FEW_SEEDS := 5
COVERAGE_SEEDS := 100
TRIAL_SEEDS := 20
# All of conf/identifier but a program of the user's, and the search of the thesis, which takes hours.
NOT_COMPARED := command nsga2_thesis
COMMA := ,
SPACE := $(subst ,, )
ORDERS := plsr,surface_plsr
IDENTIFIERS := $(subst $(SPACE),$(COMMA),$(strip $(filter-out $(NOT_COMPARED) $(subst $(COMMA),$(SPACE),$(ORDERS)),\
    $(basename $(notdir $(wildcard conf/identifier/*.yaml))))))
BELUGA := random-1 surge-1 sway-1 heave-1
RECORDINGS = $(subst $(SPACE),$(COMMA),$(BELUGA:%=$$SEATRIAL_DATA/beluga/%.csv))
define ROBUSTNESS
$(BIN)/python -m runner -m --variant identifier=$(IDENTIFIERS) \
    --variant 'identifier=$(ORDERS) identifier.bootstrap=null' \
    evaluation=none results_dir=results/robustness sweep.name=robustness hydra/launcher=processes
endef
ANY_SEED := 'seed=range(0,$(SEEDS))'
KEPT := || [ $$? -eq 1 ]
STEERED := vessel=milliampere excitation=waypoints
PUSHED := 'disturbance=noise,[constant,noise],[constant,noise_process]'
SWEPT := excitation=multisine plant.scale=0.8 controller=none
robustness: $(VENV)/demo.stamp
	$(ROBUSTNESS) $(STEERED) disturbance=calm,constant seed=0 $(KEPT)
	$(ROBUSTNESS) $(STEERED) 'disturbance=noise,[wind,noise],rough' $(ANY_SEED) $(KEPT)
	$(ROBUSTNESS) vessel=modulus_ship excitation=prbs controller=none \
	    'disturbance=calm,noise,constant,[wind,noise],rough' $(ANY_SEED) $(KEPT)
	$(ROBUSTNESS) $(SWEPT) vessel=surge_nonlinear,beluga_diagonal disturbance=calm,constant seed=0 $(KEPT)
	$(ROBUSTNESS) $(SWEPT) vessel=surge_nonlinear $(PUSHED) $(ANY_SEED) $(KEPT)
	$(ROBUSTNESS) $(SWEPT) vessel=beluga_diagonal $(PUSHED) 'seed=range(0,$(FEW_SEEDS))' $(KEPT)
	if [ -n "$$SEATRIAL_DATA" ]; then \
	    $(ROBUSTNESS) vessel=beluga_linear,beluga_diagonal,beluga_full controller=none seed=0 \
	        excitation=recording "excitation.path=$(RECORDINGS)" $(KEPT); \
	else \
	    echo 'the recordings: skipped, SEATRIAL_DATA is not set: no outside data'; \
	fi
	$(BIN)/python docs/refresh.py docs.robustness

manoeuvring: $(VENV)/demo.stamp
	nice -n 19 $(BIN)/python -m docs.manoeuvring_trials --seeds $(TRIAL_SEEDS) --write
	$(BIN)/python docs/refresh.py docs.manoeuvring_trials

next: $(VENV)/demo.stamp
	nice -n 19 $(BIN)/python -m docs.next_trials --seeds $(SEEDS) --write
	$(BIN)/python docs/refresh.py docs.next_trials

coverage: $(VENV)/demo.stamp
	$(BIN)/python -m docs.coverage --seeds $(COVERAGE_SEEDS) --write \
	    $(foreach name,robust iv ls ridge plsr,--identifier $(name))
	$(BIN)/python -m docs.coverage --seeds $(COVERAGE_SEEDS) --write --identifier output_error --disturbance noise
	$(BIN)/python -m docs.coverage --seeds $(FEW_SEEDS) --write --identifier output_error \
	    --disturbance '[constant,noise]' --disturbance '[wind,noise]'
	$(BIN)/python docs/refresh.py docs.coverage

bands: $(VENV)/demo.stamp
	$(BIN)/python -m docs.bands --write
	$(BIN)/python docs/refresh.py docs.bands

# The true coefficients differ from the nominal ones by 30 %, or not. The recording is that of an open
# loop, the same for every controller. A run that fails or diverges is kept, and counted. The supply
# vessel, 15 times as long as the ferry, is sampled a fifth as often.
DOCKED := nmpc,mpc_integral,pid_ff
define DOCKING
$(BIN)/python -m runner -m excitation=prbs evaluation=docking 'disturbance=calm,[wind,noise],[wind_current,noise]' \
    controller=$(DOCKED) $(ANY_SEED) --variant 'identifier=auto plant.scale=0.7' \
    --variant 'identifier=none plant.scale=1.0' model_error=false results_dir=results/docking sweep.name=docking \
    hydra/launcher=processes
endef
docking: $(VENV)/test.stamp  # with CasADi, for nmpc
	$(DOCKING) vessel=milliampere,cybership2 $(KEPT)
	$(DOCKING) vessel=supply_vessel sample_time_s=0.5 $(KEPT)
	$(BIN)/python docs/refresh.py docs.docking
	$(BIN)/python -m runner vessel=milliampere excitation=prbs evaluation=docking 'disturbance=[wind,noise]' controller=nmpc \
	    plant.scale=0.7 model_error=false seed=3 results_dir=results/docking_film $(KEPT)
	$(BIN)/python -m runner.compare animate 1 --to docs/assets/docking.gif --database sqlite:///results/docking_film/results.db

# Tasks on outside data are left out where SEATRIAL_DATA does not hold them. What was run is kept:
# the same command runs what is missing. BENCHMARK='--task ... --entrant ...' runs a part.
benchmark: $(VENV)/demo.stamp
	$(BIN)/python -m runner benchmark $(BENCHMARK) || [ $$? -eq 1 ]
	$(BIN)/python -m runner.compare leaderboard --page results/benchmark/index.html
	$(BIN)/python docs/refresh.py leaderboard

# The tables and the figure of README.md and the guide, made again from the demo's runs.
readme: demo
	$(BIN)/python docs/refresh.py
	cp results/figures/bars-e_pos_mae.svg docs/tracking_error.svg

# A run that fails or diverges (exit code 1) is kept and counted on the page. An experiment on
# outside data, which names SEATRIAL_DATA, is left out where there are none.
EXPERIMENTS := $(wildcard conf/experiment/*.yaml docs/published/experiment/*.yaml)
published: $(VENV)/demo.stamp
	for file in $(EXPERIMENTS); do \
	    experiment=$${file##*/}; experiment=$${experiment%.yaml}; \
	    if [ -z "$$SEATRIAL_DATA" ] && grep -q SEATRIAL_DATA $$file; then \
	        echo "$$experiment: skipped, SEATRIAL_DATA is not set: no outside data"; \
	        continue; \
	    fi; \
	    $(BIN)/python -m runner --config-dir docs/published experiment=$$experiment \
	        results_dir=results/published hydra/launcher=processes || [ $$? -eq 1 ] || exit 1; \
	done
	$(BIN)/python -m docs.published --database results/published/results.db \
	    --page results/published/index.html --summary

bench: $(VENV)/bench.stamp
	mkdir -p results
	$(BIN)/python -m pytest tests/benchmarks -o python_files='bench_*.py' -m '' -W default \
	    --timeout 3600 --benchmark-json results/bench.json
	$(BIN)/python docs/refresh.py docs.benchmarks

# Pages open from disk, their search as well.
docs: gallery
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

# Trials that are stored in results/docs are not run again.
gallery: $(VENV)/docs.stamp
	$(BIN)/python -m docs.gallery

# The same in every clone: no outside data, whatever is beside it.
test: $(VENV)/test.stamp
	unset SEATRIAL_DATA; $(PYTEST) -m 'not (slow or nightly or data)'

# Files without such a test are not even imported.
MARKED = $(sort $(shell grep -rlE 'mark\.$(1)\b' --include='test_*.py' tests))

test-data: $(VENV)/test.stamp
	$(PYTEST) -m 'data and not (slow or nightly)' $(call MARKED,data)

# Long tests share little, and many wait for servers and processes: three at once, and a worker that
# has none left takes some of another's. pytest ends with 5 when no test is marked slow: no failure.
slow: WORKERS := 3
slow: $(VENV)/test.stamp
	$(PYTEST) --dist worksteal -m 'slow and not nightly' --timeout 1800 --durations 25 $(call MARKED,slow) || { code=$$?; [ $$code -eq 5 ] || exit $$code; }

# What is a product of everything, or takes hours: all of it, also after the failure of a part.
NIGHTLY := nightly-tests dist published robustness coverage bands docking bench ray
nightly:
	failed=; for part in $(NIGHTLY); do $(MAKE) $$part || failed="$$failed $$part"; done; \
	if [ -n "$$failed" ]; then echo "make nightly: failed:$$failed" >&2; exit 1; fi

nightly-tests: $(VENV)/test.stamp
	$(PYTEST) -m nightly --timeout 3600 --durations 25

ray: $(RAY)/ray.stamp
	$(RAY)/bin/python -m pytest -m ray --timeout 1800 tests/runner/test_launchers.py

abuse: $(VENV)/test.stamp
	$(BIN)/python -m pytest -p no:benchmark -m nightly --durations 25 tests/abuse

# `make --jobs 2 check` has mypy and basedpyright side by side.
check: ruff mypy imports

ruff: $(VENV)/check.stamp
	$(BIN)/python -m ruff check .

mypy: $(VENV)/check.stamp
	$(BIN)/python -m mypy --strict

imports: $(VENV)/check.stamp
	$(BIN)/basedpyright

dist: $(VENV)/dist.stamp
	rm -rf dist
	$(BIN)/python -m build
	$(BIN)/python -m twine check --strict dist/*

clean:
	rm -rf $(VENV) $(RAY) .pytest_cache .mypy_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamps: installed again only when the packages asked for, or their versions, changed. Packages
# compile as they are imported: most of their modules never are.
$(VENV)/demo.stamp: EXTRAS :=
$(VENV)/test.stamp: EXTRAS := [test]
$(VENV)/bench.stamp: EXTRAS := [test,bench]
$(VENV)/docs.stamp: EXTRAS := [docs]
$(VENV)/dist.stamp: EXTRAS := [dist]
$(VENV)/check.stamp: EXTRAS := [test,check]
$(VENV)/check.stamp: HOLDS := $(VENV)/test.stamp

$(VENV)/%.stamp: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet --no-compile --editable '.$(EXTRAS)'
	@touch $@ $(HOLDS)

$(RAY)/ray.stamp: export PIP_CONSTRAINT := constraints-ray.txt
$(RAY)/ray.stamp: export PIP_BUILD_CONSTRAINT := constraints-ray.txt
$(RAY)/ray.stamp: pyproject.toml constraints-ray.txt | $(RAY)/bin/python
	$(RAY)/bin/python -m pip install --quiet --no-compile --editable '.[ray]' hypothesis pytest pytest-timeout
	@touch $@

# The newest supported Python that can make a virtual environment.
$(BIN)/python $(RAY)/bin/python: %/bin/python:
	@found=; lacking=; \
	for python in $(if $(PYTHON),'$(PYTHON)',python3.13 python3.12 python3.11 python3); do \
	    version=$$("$$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) || continue; \
	    case $$version in 3.11|3.12|3.13) ;; *) continue ;; esac; \
	    if "$$python" -c 'import venv, ensurepip' 2>/dev/null; then found=$$python; break; fi; \
	    lacking=$${lacking:-$$version}; \
	done; \
	if [ -n "$$found" ]; then \
	    echo "setting up $* with $$("$$found" --version)"; \
	    "$$found" -m venv $*; \
	elif [ -n "$$lacking" ]; then \
	    echo "seatrial: Python $$lacking has no venv module: install Debian's package python$$lacking-venv" >&2; \
	    exit 1; \
	else \
	    echo "seatrial: no Python 3.11, 3.12 or 3.13 found: install one, or say make PYTHON=/path/to/python" >&2; \
	    exit 1; \
	fi

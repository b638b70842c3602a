# Two commands do everything: `make demo` and `make test`. Packages, with their hashes, come from requirements/*.lock,
# which hold for every Python from 3.11.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# GPL programs, and simulators with pins of their own, live in an environment apart and run as processes of their own.
OTHERS := .venv-others
PYTHONS := 3.11 3.12 3.13

.PHONY: plain demo test quick test-rigs test-gpu test-pythons lint check-types contracts pytest schemas drawing reference docs \
        pictures paper-pictures gallery lock check-arm llvm \
        rig-programs clean bench bench-fit bench-compare bench-optics bench-mechanics bench-fuzz verification

# For a camera computer: everything but the simulation, on ARM too.
plain: $(VENV)/installed-plain

demo: $(VENV)/installed llvm
	@$(BIN)/finray demo || { status=$$?; echo "If this machine may be the cause: $(BIN)/finray doctor"; exit $$status; }

test: $(VENV)/installed-dev llvm lint check-types contracts pytest

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

check-types: $(VENV)/installed-dev
	$(BIN)/mypy

contracts: $(VENV)/installed-dev
	$(BIN)/lint-imports

# Each worker keeps to one core, where the sums of a render come in one order: a test gives the same numbers every time.
WORKERS ?= 2
pytest: $(VENV)/installed-dev
	$(BIN)/pytest -m "not rigs" --numprocesses $(WORKERS) --dist loadfile

# While you work, under a minute on two cores once mypy's cache and the compiled kernels are warm: the shape of the tree
# and what is stored, whole, and of each stage the tests that fail first. It does not stand for `make test`.
QUICK := tests/architecture tests/library/test_face.py \
         tests/schemas/test_json_schemas.py tests/schemas/test_frozen_versions.py tests/schemas/test_storage.py \
         tests/capture/test_plan.py tests/capture/test_journal.py tests/capture/test_devices.py \
         tests/radiometry/test_band_signals.py \
         tests/fit/test_likelihood.py tests/fit/test_map_search.py \
         tests/simulate/test_flat_refraction.py tests/certified/test_materials.py \
         tests/compare/test_mismatch.py tests/compare/test_validation.py \
         tests/decide/test_decision_record.py tests/decide/test_decision_sentence.py \
         tests/documentation/test_names_of_code.py tests/documentation/test_links.py tests/documentation/test_api_pages.py
quick: $(VENV)/installed-dev lint check-types contracts
	$(BIN)/pytest -m "not rigs" --numprocesses $(WORKERS) --dist loadfile $(QUICK)

# The drivers against device simulators of others. A missing program is a skip that names its package; with CI set in
# the environment it is a failure. The tests mostly wait; those that share device simulators stay on one worker.
test-rigs: $(VENV)/installed-dev $(OTHERS)/installed rig-programs
	FINRAY_OTHERS_VENV=$(CURDIR)/$(OTHERS) $(BIN)/pytest -m rigs --numprocesses 3 --dist loadscope

# What is known about the light, on an NVIDIA GPU in place of the processor; without one it says "NO GPU".
GPU_TESTS = tests/simulate/test_gpu.py tests/simulate/test_furnace_bands.py \
            tests/simulate/test_furnace_spectrum.py tests/simulate/test_energy_balance.py \
            tests/simulate/test_mitsuba_scenes.py tests/simulate/test_optics_position_map.py \
            tests/simulate/test_optics_paths.py tests/simulate/test_fluorescence_levels.py \
            tests/simulate/test_fluorescent_regression.py tests/simulate/test_optics_render.py \
            tests/simulate/test_optics_curved_refraction.py tests/simulate/test_shared_gathers.py \
            tests/simulate/test_mirror_guide.py tests/simulate/test_poisoned_lanes.py
test-gpu: $(VENV)/installed-dev llvm
	FINRAY_TEST_ENGINE=cuda $(BIN)/pytest -rs -m renderer $(GPU_TESTS)

# The demo and all tests on every Python that is here, each in an environment of its own (.venv-3.12); hours. What was
# skipped stands at the end: it is the barrier contact only, and only where the processor has no AVX2.
test-pythons:
	@failed=""; \
	for version in $(PYTHONS); do \
	  python=""; \
	  for found in python$$version $$HOME/.pyenv/versions/$$version.*/bin/python; do \
	    if $$found -c "" 2>/dev/null; then python=$$found; fi; \
	  done; \
	  if [ -z "$$python" ]; then failed="$$failed $$version (not found)"; continue; fi; \
	  rm -rf .venv-$$version/demo; \
	  $(MAKE) PYTHON=$$python VENV=.venv-$$version .venv-$$version/installed-dev llvm && \
	  .venv-$$version/bin/finray demo --out .venv-$$version/demo && \
	  .venv-$$version/bin/pytest -m "not rigs" --junitxml=.venv-$$version/tests.xml || failed="$$failed $$version"; \
	done; \
	for version in $(PYTHONS); do \
	  echo "Python $$version:"; grep -o 'skipped type="pytest.skip" message="[^"]*' .venv-$$version/tests.xml | sort | uniq -c; \
	done; \
	if [ -n "$$failed" ]; then echo "FAILED:$$failed"; exit 1; fi

# The numbers of docs/verification.md, as ratios against public alternatives in the same run: several hours on two
# cores, or one stage at a time (make bench-fit). Each script prints what it found and exits with 1 when a bar is
# missed; the table at the end says what is met, and without --complete leaves room for what was not run.
# MATERIALS holds measured matrices (CSV). A calibration study that was stopped goes on where it was.
MATERIALS ?= ../shared/data/spectra/materials
MODELS    := default zheng2014 skew_t log_normal_wavenumber gaussian_mixture
ONE       := OMP_NUM_THREADS=1 XLA_FLAGS=--xla_cpu_multi_thread_eigen=false
STAGES    := bench-fit bench-compare bench-optics bench-mechanics
PYTEST_BENCH := $(BIN)/pytest --benchmark-columns=median,iqr,rounds

bench: $(VENV)/installed-bench llvm
	rm -rf bench-out
	@for stage in $(STAGES); do $(MAKE) $$stage; done
	$(BIN)/python benchmarks/table.py --complete bench-out

bench-fit: $(VENV)/installed-bench
	-$(ONE) $(BIN)/python benchmarks/samplers.py --out bench-out/samplers.json
	-$(BIN)/python benchmarks/fit_command_time.py --out bench-out/fit-command.json
	-$(ONE) $(BIN)/python benchmarks/session_time.py --out bench-out/session-time.json
	-$(ONE) $(BIN)/python benchmarks/leave_one_material_out.py --materials $(MATERIALS) --out bench-out/left-out.json
	-for model in $(MODELS); do $(ONE) $(BIN)/python benchmarks/simulation_based_calibration.py --model $$model \
	  --out bench-out/sbc-$$model.json; done
	-$(PYTEST_BENCH) benchmarks/test_pixel_maps.py benchmarks/test_photon_transfer.py \
	  benchmarks/test_radiometry_memory.py -o junit_family=xunit1 --junitxml=bench-out/pytest.xml
	-$(BIN)/python benchmarks/table.py bench-out

bench-compare: $(VENV)/installed-bench llvm
	-$(BIN)/python benchmarks/comparison_throughput.py --out bench-out/comparison-throughput.json
	-$(PYTEST_BENCH) benchmarks/test_image_metrics.py
	-$(ONE) $(BIN)/python benchmarks/light_angle_decision.py --out bench-out/light-angle-decision.json
	-$(BIN)/python benchmarks/digital_twins.py --out bench-out/digital-twins.json
	-$(BIN)/python benchmarks/table.py bench-out

bench-optics: $(VENV)/installed-bench llvm
	-$(BIN)/python benchmarks/fluorescence_levels.py --spectral --twice --out bench-out/fluorescence-levels.json
	-$(BIN)/python benchmarks/angle_sweep_bias.py
	-$(BIN)/python benchmarks/angle_sweep_speed.py --out bench-out/angle-sweep.json
	-$(BIN)/python benchmarks/whole_image_time.py --out bench-out/whole-image.json
	-$(PYTEST_BENCH) benchmarks/test_recoloured_render.py
	-$(BIN)/python benchmarks/table.py bench-out

# Some 5,000 mutated files through every reader; hours on a busy machine. Stopped, it goes on where it was.
bench-fuzz: $(VENV)/installed-dev
	$(BIN)/python benchmarks/fuzz_readers.py --out bench-out/fuzz-readers.jsonl

bench-mechanics: $(VENV)/installed-bench
	-$(BIN)/python benchmarks/mechanics_engines.py --out bench-out/mechanics-engines.json
	-$(BIN)/python benchmarks/finger_mesh_convergence.py --out bench-out/finger-mesh-convergence.json
	-$(BIN)/python benchmarks/finger_press_times.py --out bench-out/finger-press-times.json
	rm -rf bench-out/finger-stiffness
	-$(BIN)/finray study finger-stiffness flat-70x35 flat-70x35-soft --out bench-out/finger-stiffness
	-$(BIN)/python benchmarks/published_fin_ray.py --out bench-out/published-fin-ray.json
	-$(BIN)/python benchmarks/table.py bench-out

# What docs/verification.md names exists; results that lie in bench-out are written into it.
verification: $(VENV)/installed-dev
	$(BIN)/python -m docs.verification_rows --bench bench-out

# JSON Schema files of all records; tests fail when they drift from the models.
schemas: $(VENV)/installed-dev
	$(BIN)/python -m data_schemas.json_schemas

# The packages, drawn in docs/explanation/architecture.md and listed in docs/reference/rooms.md; a test compares them with the code.
drawing: $(VENV)/installed-dev
	$(BIN)/python -m docs.rooms_drawing

# The pages of docs/reference, from the code; tests fail when they differ.
reference: $(VENV)/bin/python
	$(BIN)/python -m docs.api_pages

# The documentation as a site in site/, with search; a broken link or a warning is an error.
docs: $(VENV)/installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --clean --quiet
	@echo "site/index.html is made; to search in it, serve it: $(BIN)/python -m http.server --bind 127.0.0.1 --directory site"

# Pictures of the README and of how-tos, by the commands that their pages tell; some ten minutes.
pictures: $(VENV)/installed-dev llvm
	$(BIN)/python -m docs.pictures $(PICTURES)

# Those of docs/reference/paper-experiments.md, by its studies; points of another commit are computed anew. RENEW= keeps them.
PAPER_STUDIES ?= $(VENV)/studies
RENEW         ?= --renew
paper-pictures: $(VENV)/installed-dev llvm
	@for study in pad-shapes finger-family everyday-objects; do \
	  $(BIN)/finray study run $$study $(RENEW) --out $(PAPER_STUDIES)/$$study && \
	  cp $(PAPER_STUDIES)/$$study/pictures.webp docs/images/$$study.webp || exit 1; \
	done

# The pictures of docs/gallery.md, by running what stands there; some ten minutes.
gallery: $(VENV)/installed-dev llvm
	$(BIN)/python -m docs.gallery

# Renew the pinned versions and their hashes. Versions stay where they can; newest ones: make lock UPGRADE=--upgrade
UPGRADE ?=
COMPILE  = .venv-lock/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header \
           --no-annotate $(UPGRADE)
lock: .venv-lock/installed
	$(COMPILE) pyproject.toml --group build --extra dev --extra bench --output-file requirements/bench.lock
	$(COMPILE) pyproject.toml --group build --extra dev -c requirements/bench.lock --output-file requirements/dev.lock
	$(COMPILE) pyproject.toml --group build --extra docs -c requirements/bench.lock --output-file requirements/docs.lock
	$(COMPILE) pyproject.toml --group build --extra sim -c requirements/bench.lock --output-file requirements/sim.lock
	$(COMPILE) pyproject.toml --group build -c requirements/bench.lock --output-file requirements/plain.lock
	$(COMPILE) requirements/others.in --output-file requirements/others.lock

.venv-lock/installed:
	$(PYTHON) -m venv .venv-lock
	.venv-lock/bin/python -m pip install --quiet --disable-pip-version-check 'uv>=0.9'
	@touch $@

# Whether the plain installation needs wheels alone on 64-bit ARM (Raspberry Pi OS and Debian from 11 on, Ubuntu from
# 20.04 on): downloads nothing but their names and metadata.
check-arm: $(VENV)/bin/python
	@for version in $(PYTHONS); do \
	   $(BIN)/python -m pip install --dry-run --quiet --disable-pip-version-check --ignore-installed --target /nonexistent \
	     --only-binary=:all: --implementation cp --python-version $$version $(ARM_PLATFORMS) \
	     --require-hashes --requirement requirements/plain.lock && \
	     echo "Python $$version on aarch64: the plain installation resolves with wheels alone" || exit 1; \
	 done
ARM_PLATFORMS := $(foreach glibc,2_17 2_24 2_26 2_27 2_28,--platform manylinux_$(glibc)_aarch64) \
                 --platform manylinux2014_aarch64

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "finray needs Python 3.11 or newer; this is $$($(PYTHON) --version). Give another one: make PYTHON=python3.12 ..."; exit 1; }
	$(PYTHON) -m venv $(VENV) || \
	  { echo "cannot make a virtual environment; on Debian and Ubuntu: apt-get install python3-venv"; exit 1; }

# All that an installation fetches is named, with its hash, in one file.
define install
$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --requirement requirements/$(1).lock
$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
@touch $@
endef

$(VENV)/installed-plain: $(VENV)/bin/python pyproject.toml requirements/plain.lock
	$(call install,plain)

$(VENV)/installed: $(VENV)/bin/python pyproject.toml requirements/sim.lock
	$(call install,sim)

$(VENV)/installed-docs: $(VENV)/bin/python pyproject.toml requirements/docs.lock
	$(call install,docs)

$(VENV)/installed-dev: $(VENV)/bin/python pyproject.toml requirements/dev.lock
	$(call install,dev)
	@touch $(VENV)/installed $(VENV)/installed-docs

$(VENV)/installed-bench: $(VENV)/installed-dev requirements/bench.lock
	$(call install,bench)

$(OTHERS)/installed: requirements/others.lock
	$(PYTHON) -m venv $(OTHERS)
	$(OTHERS)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes \
	  --requirement requirements/others.lock
	@touch $@

RIG_PACKAGES := indi-bin aravis-tools-cli libaravis-0.8-0 qemu-system-misc gcc-avr avr-libc ffmpeg ustreamer socat \
                calculix-ccx chromium poppler-utils qemu-user tmux
rig-programs:
	@missing=""; for package in $(RIG_PACKAGES); do \
	   dpkg-query -W -f '$${db:Status-Status}' $$package 2>/dev/null | grep -qx installed || missing="$$missing $$package"; \
	 done; \
	 if [ -z "$$missing" ]; then exit 0; fi; \
	 echo "installing device simulators:$$missing"; \
	 if [ "$$(id -u)" = 0 ]; then as=""; elif [ -t 0 ]; then as="sudo"; else as="sudo -n"; fi; \
	 if $$as apt-get update -qq && $$as apt-get install -y -qq --no-install-recommends $$missing; then exit 0; fi; \
	 echo; \
	 echo "The device simulators could not be installed; the tests that need them are skipped, or fail where CI is set."; \
	 echo "Ask your administrator for:  apt-get install --no-install-recommends$$missing"; \
	 echo

# The renderer compiles its kernels with LLVM 17 or newer (15 and 16 crash) and needs libatomic; two Debian packages.
llvm:
	@if ldconfig -p 2>/dev/null | grep -qE 'libLLVM(-|\.so\.)(1[7-9]|[2-9][0-9])' \
	    && ldconfig -p 2>/dev/null | grep -q 'libatomic\.so\.1'; then exit 0; fi; \
	 echo "installing libllvm19 and libatomic1, libraries of the renderer"; \
	 if [ "$$(id -u)" = 0 ]; then as=""; elif [ -t 0 ]; then as="sudo"; else as="sudo -n"; fi; \
	 if $$as apt-get update -qq && $$as apt-get install -y -qq --no-install-recommends libllvm19 libatomic1; then exit 0; fi; \
	 echo; \
	 echo "They could not be installed. Without libllvm19 finray still runs, with the scalar renderer: fewer paths and more"; \
	 echo "noise. Without libatomic1 nothing is rendered. Ask your administrator for:  apt-get install libllvm19 libatomic1"; \
	 echo

clean:
	rm -rf site .venv .venv-* .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache bench-out

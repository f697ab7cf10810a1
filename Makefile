# Two commands do it all: `make run` (the main job) and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
JOBS ?= 2

.PHONY: run run-all test lint check verify elementary machines prove fuzz fuzz-inputs interrupts names flips mutants \
  thorough vectors soak bench reproduce docs setup clean misprints

run: $(READY)
	$(BIN)/pfaffian run

test: $(READY) lint
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The slow form of the verification, and the benchmarks.
verify: $(READY)
	$(BIN)/pfaffian verify pendubot --samples 100000

# The elementary functions at a million points each (minutes), proofs and costs included.
elementary: $(READY)
	PFAFFIAN_THOROUGH=1 PFAFFIAN_ELEMENTARY_POINTS=250000 $(BIN)/python -m pytest -n $(JOBS) \
	  tests/test_elementary_*.py

# One trajectory of 30,000 periods on every machine there is: its hashes must be one.
machines: $(READY)
	PFAFFIAN_FLIGHT_STEPS=30000 $(BIN)/python -m pytest -v -s tests/test_flight_programs.py -k one_trajectory

# Static analysis, sanitizers and proofs; `make test` runs most of them too. -rs names what is skipped.
prove: $(READY)
	PFAFFIAN_THOROUGH=1 PFAFFIAN_PROVE_ALL=1 $(BIN)/python -m pytest -rs tests/test_misra.py \
	  tests/test_sanitizers.py tests/test_eva.py tests/test_eva_control.py tests/test_elementary_proofs.py \
	  tests/test_c_contract.py tests/test_arithmetic.py

# The fuzzer for TIME seconds each on the step, the supervisor and the control; a million bit flips
# in each part of the step and of the control, with their rates.
TIME ?= 60
fuzz: $(READY)
	PFAFFIAN_FUZZ_SECONDS=$(TIME) $(BIN)/python -m pytest -s -rs tests/test_fuzz.py -k finds_nothing

# Documents and command lines as nobody would write them: TRIES of them must end in a message.
TRIES ?= 20000
fuzz-inputs: $(READY)
	PFAFFIAN_FUZZ_TRIES=$(TRIES) $(BIN)/python -m pytest -s -n $(JOBS) tests/test_fuzz_inputs.py

# Every command interrupted at many moments, in seconds from its first line on.
DELAYS ?= 0,0.02,0.05,0.1,0.15,0.2,0.3,0.5,0.7,1,1.5,2,3,5,8
interrupts: $(READY)
	PFAFFIAN_INTERRUPT_DELAYS=$(DELAYS) $(BIN)/python -m pytest tests/test_interrupt.py

# The whole suite with what the default leaves to this target: tests/thorough.toml names it.
thorough: $(READY) lint
	PFAFFIAN_THOROUGH=1 $(BIN)/python -m pytest -n $(JOBS) --dist loadfile

# The main job of each of the ten models (minutes).
run-all: $(READY)
	PFAFFIAN_RUN_ALL=1 $(BIN)/python -m pytest -n $(JOBS) tests/test_run_anywhere.py

# 300 names as coordinate, parameter, gain, actuator and constraint, alone and with several (long).
names: $(READY)
	PFAFFIAN_THOROUGH=1 PFAFFIAN_NAMES=all $(BIN)/python -m pytest -n $(JOBS) tests/test_names.py

flips: $(READY)
	PFAFFIAN_THOROUGH=1 PFAFFIAN_FLIPS=1000000 $(BIN)/python -m pytest -s tests/test_bit_flips.py \
	  tests/test_control_flips.py tests/test_control_bits.py

# Each of the planted faults of tests/mutants in a scratch copy, against the tests that must notice.
mutants: $(READY)
	$(BIN)/python tests/mutants/run.py --jobs $(JOBS)

# The vectors for builds on other hardware, computed again.
vectors: $(READY)
	$(BIN)/python -m pfaffian.derive.verify.vectors pendubot > runtime/vectors/pendubot_vectors.h

# An hour of flight at 1 kHz, in the Linux harness as fast as it goes and on the bare machine.
soak: $(READY)
	PFAFFIAN_SOAK_STEPS=3600000 $(BIN)/python -m pytest -s -rs -k "long_flight or soak" \
	  tests/test_linux_harness.py tests/test_flight_programs.py

bench: $(READY)
	$(BIN)/pfaffian bench regenerate

# Every simulation of the paper, its convergence tables and the verdicts on its claims (minutes).
reproduce: $(READY)
	$(BIN)/pfaffian reproduce all

# Every printed block of the README and of docs/ run again and compared (long); `make docs
# RENEW=--write` puts the figures printed now into the pages.
docs: $(READY)
	$(BIN)/python docs/printed.py $(RENEW)

# Every sign, number and symbol of the audited equations misprinted in turn (minutes).
misprints: $(READY)
	PFAFFIAN_EVERY_MISPRINT=1 $(BIN)/python -m pytest -n $(JOBS) tests/test_audit.py -k every_sign

setup: $(READY)

$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "pfaffian needs Python 3.11 or newer; name one with: make PYTHON=python3.12 ..."; exit 3; }
	@echo "setting up $(VENV) from requirements.lock (once)"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "Python's venv module is missing; get it with: apt-get install python3-venv"; exit 3; }
	$(BIN)/python -m pip install --disable-pip-version-check --progress-bar off -r requirements.lock
	$(BIN)/python -m pip install --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $(READY)

clean:
	rm -rf $(VENV) build dist report .mypy_cache .pytest_cache .ruff_cache .hypothesis

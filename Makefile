# SPDX-License-Identifier: Apache-2.0
# The front door. Each command sets up what it needs (tools/setup) and can be repeated.
MAKEFLAGS += --no-print-directory
PYTHON := .venv/bin/python
JOBS ?= $(shell nproc)
WORKERS ?= $(shell expr 2 \* $(JOBS))
# These start hundreds of Python processes. Each would compile what it imports if nobody kept it.
test test-fast check check-all: export PYTHONPYCACHEPREFIX := $(CURDIR)/build/pycache
test test-fast check check-all: export PYTHONDONTWRITEBYTECODE :=

.PHONY: help demo no-other-demo test test-fast test-arm64 boards check check-all bench bench-isolation bench-swap soak format clean setup release
.DEFAULT_GOAL := help

help:  ## this list
	@echo "LITHE: a real-time Spine whose control law can be replaced while the robot moves"
	@awk -F ':.*## ' '/^[a-z0-9-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' Makefile

demo: TARGETS := --target lithe lithe-spine lithe-spine-sim lawd lithe-trial lithe-sim
demo: no-other-demo release  ## the experiment on a simulated arm (or ROBOT=FILE): probe, learn, swap laws live, survive a dead Brain -> out/demo/
	@$(PYTHON) -m lithe.demo $(if $(ROBOT),--robot $(ROBOT)) $(if $(AGENT),$(if $(filter llm,$(AGENT)),--llm-url '$(LLM_URL)' \
	  --model '$(MODEL)',$(error AGENT=$(AGENT) is none: leave it out, or AGENT=llm LLM_URL=URL MODEL=NAME)))

test: PACKAGES := build test
test: TARGETS := $(if $(ROOM),--target $(ROOM)_tests)
test: ROOMS := cmake --build --preset release --target help | sed -nE "s/^([a-z0-9_]+)_tests: .*/\1/p" | grep -vx tick | sort -u
test: KNOWN = $(if $(ROOM),{ $(ROOMS) | grep -qx $(ROOM) || { echo "make test: there is no room $(ROOM). Rooms:" $$($(ROOMS)) >&2; exit 1; }; } &&)
test: release  ## every test: C++ (ctest), then Python and across processes (pytest); ROOM=guard for the C++ tests of one room
	@$(PYTHON) tools/run_tests.py --workers $(WORKERS) $(if $(ROOM),--room $(ROOM))

test-fast: PACKAGES := build test
test-fast: release  ## C++ tests without properties of thousands of runs and fuzzer seeds; of Python the tools' tests
	@ctest --preset release -j $(WORKERS) --progress -LE '^(limits|fuzz|mutant)$$'
	@$(PYTHON) -m pytest tests/tools tests/test_schema_roundtrip.py

test-arm64:  ## the C++ tests for 64-bit ARM: cross-built, run under QEMU; ROOM=guard for those of one room
	@tools/setup build
	@$(PYTHON) tools/cross.py --jobs $(JOBS) $(if $(ROOM),--room $(ROOM))

boards: TARGETS := --target lithe lithe-spine lithe-spine-sim lawd lithe-trial lithe-sim
boards: release  ## LITHE on emulated boards: isolated cores, PREEMPT_RT, 64-bit ARM; BOARD=x, r or a for one of them -> out/boards.json
	@$(PYTHON) tools/vm/boards.py $(if $(BOARD),--board $(BOARD))

check:  ## what CI asks: format, tidy, rooms, schema, limits, types, ASan+UBSan, TSan, RTSan, fuzzers, 64-bit ARM
	@tools/setup build test check bench
	@tools/setup arm64 || echo "make check: without these packages the step arm64 is skipped" >&2
	@$(PYTHON) tools/check.py

check-all:  ## check, and what takes too long for every merge: all tests under ASan and for ARM, emulated boards, Debian 13, a minute of each fuzzer, mutants, long tests
	@tools/setup build test check bench vcan arm64 boards debian13
	@$(PYTHON) tools/check.py --all

bench:  ## jitter, tick cost, scale, Channel latency, each against a peer and a control that must fail -> out/bench/
	@tools/setup build bench
	@cmake --preset bench --log-level=WARNING >/dev/null
	@cmake --build --preset bench -j $(JOBS)
	@$(PYTHON) -m bench.report

bench-isolation:  ## release jitter under five loads, beside cyclictest, a sleeping loop and moteus; SHIELD=1 PAPER=1 SHORT=1 -> out/bench/isolation.*
	@tools/setup build bench
	@cmake --preset bench --log-level=WARNING >/dev/null
	@cmake --build --preset bench -j $(JOBS) --target bench_isolation bench_plain_loop bench_cores lithe lithe-spine lithe-spine-sim lithe-sim \
	  lawd lithe-trial
	@$(PYTHON) -m bench.isolation $(if $(SHORT),--short) $(if $(PAPER),--paper) $(if $(SHIELD),--shield)

bench-swap: TARGETS := --target lithe lithe-spine lithe-spine-sim lawd lithe-trial bench_swap_peers
bench-swap: release  ## what a swap costs, beside dlopen in the loop and behind a mutex; SWAPS=10000 -> out/bench/swap.json
	@$(PYTHON) -m bench.swap --swaps $(or $(SWAPS),10000)

soak: TARGETS := --target lithe lithe-spine lithe-spine-sim lithe-sim lawd lithe-trial
soak: release  ## hours of random swaps, kills, bus faults and loads on a simulated arm (HOURS=2 SEED=7 RESUME=1) -> out/soak.json
	@$(PYTHON) -m tools.soak $(if $(HOURS),--hours $(HOURS)) $(if $(SEED),--seed $(SEED)) $(if $(RESUME),--resume) $(if $(ROBOT),--robot $(ROBOT))

format:  ## rewrite every file the way `make check` wants it
	@tools/setup build check
	@$(PYTHON) tools/check.py --fix

no-other-demo:  # before anything is built: it would change the programs under the other's feet
	@[ ! -e out/demo/.lock ] || flock --nonblock out/demo/.lock true || { \
	  echo "make demo: another demo runs in this checkout (out/demo): wait for it, or use another checkout" >&2; exit 1; }

release:
	@tools/setup $(or $(PACKAGES),build)
	@mkdir -p build && flock build/.lock sh -c 'cmake --preset release --log-level=WARNING >/dev/null && $(KNOWN) \
	  cmake --build --preset release -j $(JOBS) $(TARGETS)'  # a second build waits for the first

clean:  ## remove build/, out/ and .venv/
	rm -rf build out .venv

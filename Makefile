# Two commands matter: make demo, make test. Both set themselves up (scripts/setup says how) and are quick the second time.
PYTHON ?= python3
export PYTHON
BIN = .venv/bin

.PHONY: help demo test lint format bench accuracy faults audit deb test-platform clean

help:
	@echo "make demo    a simulated day of one span: the real daemon, a broker, a plot (under out/)"
	@echo "make test    linters, types and tests, as continuous integration runs them"
	@echo "make lint    linters and types alone"
	@echo "make format  put the source into its standard form"
	@echo "make bench   speed, memory, idle cost, and the errors of the code that is timed (ten minutes; docs/performance.md)"
	@echo "make accuracy   errors and coverage over many drawn worlds (an hour; docs/accuracy.md, missed.md, monte-carlo.md)"
	@echo "make faults  thousands of faults, and what became of the readings (some twenty minutes; ONLY=kill,disk for parts)"
	@echo "make test-platform   whole machines, three quarters of an hour: packages, booted systems, cameras, aarch64 (docs/platform.md; JOBS=2)"
	@echo "make audit   known holes in the pinned packages, asked of PyPI (or DATABASE=a checkout of its advisories)"
	@echo "make deb     Debian packages for Bookworm and Trixie, arm64 and amd64 (under build/)"
	@echo "make clean   remove the environment and everything that was generated"

demo:
	@scripts/setup demo
	@$(BIN)/sagnode demo

test:
	@scripts/setup dev
	@scripts/check

lint:
	@scripts/setup dev
	@scripts/check lint

format:
	@scripts/setup dev
	@$(BIN)/ruff check --fix --quiet .
	@$(BIN)/ruff format .

bench:
	@scripts/setup dev
	@$(BIN)/python benchmarks/performance/run.py

accuracy:
	@scripts/setup dev
	@$(BIN)/python benchmarks/run.py
	@$(BIN)/python benchmarks/missed.py
	@$(BIN)/python benchmarks/montecarlo.py

faults:
	@scripts/setup dev
	@$(BIN)/python tests/faults/campaign.py --report docs/reliability.md $(if $(ONLY),--only $(ONLY))

test-platform:
	@scripts/setup dev
	@$(BIN)/python tests/platform/lanes.py

audit:
	@scripts/setup dev
	@$(BIN)/python scripts/audit.py $(if $(DATABASE),--database $(DATABASE))

deb:
	@scripts/setup dev
	@$(BIN)/python deploy/build_deb.py

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis out build dist src/*.egg-info src/sagnode/native/*.so
	find src tests benchmarks -name __pycache__ -prune -exec rm -rf {} +

# Everything a user or developer runs. `make help` lists it.
PYTHON ?= python3
CORES ?= 2
BIN := .venv/bin
REAL_SITES := junction_mls autzen_arterial delft montpellier_street kitti_0009 kitti_0009_sparse
comma := ,
empty :=
space := $(empty) $(empty)

.DEFAULT_GOAL := help
.PHONY: help run real truth paper paper-long studio studio-vendor test test-full bench bench-full lint format config lock dag docs clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

.venv/.installed: envs/requirements.lock pyproject.toml scripts/check_machine.py
	@$(PYTHON) scripts/check_machine.py
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r envs/requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

# Open3D is an engine that nothing needs: where it does not fit or cannot be had, one line says so. What
# failed on the way is tried again by the next call.
.venv/.installed-open3d: .venv/.installed envs/requirements-open3d.lock
	@if ! $(BIN)/python scripts/check_machine.py open3d; then touch $@; \
	elif $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes \
	  -r envs/requirements-open3d.lock; then $(BIN)/python -m roadsight.base.engines || true; touch $@; \
	else echo "Open3D is left out, it could not be installed; all results come without it" >&2; fi

.venv/.installed-dev: .venv/.installed envs/requirements-dev.lock | .venv/.installed-open3d
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r envs/requirements-dev.lock
	@touch $@

run: .venv/.installed .venv/.installed-open3d ## install from the lock and run the workflow on the embedded sample
	$(BIN)/snakemake --cores $(CORES)

real: .venv/.installed ## run the workflow on the real clouds under ROADSIGHT_DATA
	@test -n "$$ROADSIGHT_DATA" || { echo "make real: set ROADSIGHT_DATA to the folder that holds clouds/" >&2; exit 2; }
	$(BIN)/snakemake --cores $(CORES) --config 'sites=[$(subst $(space),$(comma),$(REAL_SITES))]'

truth: .venv/.installed ## the product on the real data under ROADSIGHT_DATA, beside peers
	$(BIN)/snakemake --cores $(CORES) truth

paper: .venv/.installed ## tables and figures of both studies: published, ours as published, ours by default
	$(BIN)/snakemake --cores $(CORES) paper

paper-long: .venv/.installed ## the same on sites as large as the studies' (hours)
	$(BIN)/snakemake --cores $(CORES) paper_long

studio: .venv/.installed ## the local web application: see, draw, register, run
	$(BIN)/roadsight studio

test: .venv/.installed-dev ## the tests, but for long ones and those that need a finished site or a browser
	$(BIN)/python -m pytest -m "not full" -n $(CORES) --dist loadgroup

test-full: .venv/.installed-dev ## all tests, as CI
	$(BIN)/python -m pytest -n $(CORES) --dist loadgroup --durations 20

bench: .venv/.installed-dev ## side-by-side benchmarks into results/bench: bench.json and a page
	$(BIN)/python benchmarks/run.py --out results/bench/bench.json

bench-full: .venv/.installed-dev ## the same with the published sizes, and ten times the points
	$(BIN)/python benchmarks/run.py --size full --out results/bench/bench.json

lint: .venv/.installed-dev ## style, types, rule files
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/snakefmt --check Snakefile workflow/rules
	$(BIN)/snakemake --lint

format: .venv/.installed-dev ## rewrite in the house style
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/snakefmt Snakefile workflow/rules

config: .venv/.installed ## regenerate config/config.yaml from the schema
	$(BIN)/python -m roadsight.config.render

lock: ## resolve the dependencies anew (needs uv)
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate \
	  --custom-compile-command "make lock" pyproject.toml -o envs/requirements.lock
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate \
	  --custom-compile-command "make lock" -c envs/requirements.lock \
	  --group open3d -o envs/requirements-open3d.lock
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate \
	  --custom-compile-command "make lock" --extra dev -c envs/requirements.lock \
	  -c envs/requirements-open3d.lock pyproject.toml -o envs/requirements-dev.lock

studio-vendor: ## bundle the studio's JavaScript libraries anew from web/package-lock.json (needs npm)
	cd web && npm ci --no-audit --no-fund && npm run build
	cp web/node_modules/three/LICENSE workflow/roadsight/studio/assets/vendor/three.LICENSE

docs: .venv/.installed-dev ## the documentation as a site, site/html/index.html; a broken link fails it
	$(BIN)/python -m scripts.pages.build site

clean: ## remove results, logs and the environment
	rm -rf results logs site .snakemake .venv

dag: .venv/.installed ## redraw the pictures of docs/architecture.md from the code (needs graphviz and what `make run` leaves)
	$(BIN)/python scripts/rooms.py docs/images/rooms.svg
	for job in placement poles all; do \
	  $(BIN)/snakemake $$job --rulegraph dot | $(BIN)/python scripts/flow.py docs/images/flow-$$job.svg || exit 1; \
	done

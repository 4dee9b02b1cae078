# Delfim. `make` lists the targets; each of them first makes what it needs in ./.venv, from pinned and hashed packages.
# PYTHON=... chooses the interpreter (3.11 or newer); ARGS="..." is handed to the program that a target runs.

PYTHON ?= python3
ARGS   ?=
WORKERS ?= 3
BESIDE := -n $(WORKERS) --no-loadscope-reorder
VENV   ?= .venv
BIN    := $(VENV)/bin
BOAT   := $(VENV)/.boat
READY  := $(VENV)/.ready
WEB    := delfim/console/web
NPM    := $(WEB)/node_modules/.package-lock.json
MORE   := $(VENV)/.formats
OTHERS := $(VENV)/.others
MANUAL := $(VENV)/.manual
FILM   := $(VENV)/.webrtc
LOCKS  := $(addprefix requirements/,boat.txt services.txt ground.txt build.txt)

# What the tests need of a Debian machine beside Python: a kernel that runs as a process, tools to look at it, and the clients
# that people use: a browser, FTP, SSH, Octave.
SYSTEM_PACKAGES := user-mode-linux gcc libc6-dev kmod iproute2 can-utils busybox-static dmsetup e2fsprogs chromium curl lftp openssh-client openssl \
	tnftp wget qemu-system-x86 qemu-system-arm qemu-user grub-pc-bin grub-common octave octave-instrument-control podman crun gpsd rtklib mosquitto dosfstools mtools ffmpeg
SYSTEM_PROGRAMS := linux.uml cc modprobe ip candump busybox dmsetup e2fsck chromium curl lftp ssh openssl tnftp wget \
	qemu-system-x86_64 qemu-system-aarch64 qemu-aarch64 grub-mkimage octave-cli podman gpsd str2str mosquitto ffmpeg

export PYTHONSAFEPATH := 1
unexport PYTHONDONTWRITEBYTECODE # with it each program that a test starts compiles all of Delfim again
export PATH := $(PATH):/usr/sbin:/sbin:$(CURDIR)/$(BIN)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help run test test-long again fast seeds check page docs pictures bench image deb wheel release audit system guest-shell formats lock clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 22

run: $(BOAT) ## sail the whole DelfimX in simulation, with the console in the browser
	$(BIN)/delfim sim etc/delfimx.toml --console $(ARGS)

test: $(MORE) system ## run the tests, those on a real SocketCAN bus included, so many side by side (WORKERS=3)
	$(BIN)/pytest $(BESIDE) -m "not long" $(ARGS)

test-long: $(MORE) $(OTHERS) $(MANUAL) $(FILM) system ## run the tests that take longest, three side by side: images, power cuts, failing disks, bad neighbours, benchmarks
	$(BIN)/pytest -n 3 --no-loadscope-reorder -m long $(ARGS)

again: $(MORE) $(OTHERS) $(FILM) ## run the tests that failed last, alone
	$(BIN)/pytest -n 1 --no-loadscope-reorder --last-failed --last-failed-no-failures none -rA $(ARGS)

fast: $(MORE) ## run the tests that need no guest, with ARGS="..." and WORKERS as for test
	$(BIN)/pytest $(BESIDE) -m "not long" --ignore tests/guest $(ARGS)

seeds: $(MORE) ## sail a campaign of 1,000 runs of mixed faults (docs/campaigns.md)
	$(BIN)/delfim campaign etc/campaigns/mixed.toml $(ARGS)

.PHONY: mutants
mutants: $(MORE) ## change the safety core, one place at a time, and see that a test notices (docs/mutants.md; ARGS="--since HEAD~1")
	PYTHONPATH=. $(BIN)/python -m bench.mutants $(ARGS)

.PHONY: safety
safety: $(READY) ## prove what is new or stale in the safety case, and write its page (docs/safety-case.md; ARGS=--all: prove everything again)
	PYTHONPATH=. $(BIN)/python -m safety $(ARGS)

.PHONY: compliance
compliance: $(MORE) ## run the tests by which rules are answered, and write the page of it (docs/compliance.md)
	PYTHONPATH=. $(BIN)/python -m compliance $(ARGS)

.PHONY: encounters
encounters: $(MORE) ## sail DNV's encounters and Imazu's with and without the guard (docs/encounters.md; ARGS="--seeds 100")
	$(BIN)/python -m bench.record $(ARGS)

.PHONY: oracles
oracles: $(READY) ## make anew what the tests hold today's behaviour against (CONTRIBUTING.md; ARGS="boats telemetry": some of it)
	PYTHONPATH=. $(BIN)/python -m tests.oracles $(ARGS)

check: $(READY) $(NPM) ## style, types, the direction of imports, and the links and proofs of the safety case
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	PYTHONPATH=. $(BIN)/python -m safety --check
	$(WEB)/node_modules/.bin/tsc --noEmit --project $(WEB)

page: $(NPM) ## build the console's page from its sources again, as it is shipped
	$(WEB)/node_modules/.bin/tsc --noEmit --project $(WEB)
	node $(WEB)/build.mjs

docs: $(MANUAL) ## make the site of the documentation, in run/site (ARGS=--pdf: one file of it, too)
	PYTHONPATH=. $(BIN)/python -m manual --scripts $(VENV)/scripts $(ARGS)

pictures: $(READY) ## draw the documentation's pictures again
	$(BIN)/delfim sim etc/delfimx.toml --lockstep --output run/pictures
	cp run/pictures/track.png docs/pictures/
	$(BIN)/python -m bench.record --picture docs/pictures/encounters.png
	$(BIN)/python -m bench.encounters --first 30565 --count 1 --picture docs/pictures/encounters-left.png
	$(BIN)/python -m tests.vehicle.estimator_trial docs/pictures
	$(BIN)/delfim survey lines etc/areas/basin.geojson --spacing 10 --output run/pictures/basin.toml --picture docs/pictures/survey.png
	$(BIN)/python -m tests.survey.pictures docs/pictures
	$(BIN)/python -m tests.simulator.test_missions docs/pictures
	xz -dc tests/data/charts/US5OH10M.000.xz > run/pictures/US5OH10M.000
	$(BIN)/delfim charts run/pictures/US5OH10M.000 --at 41.76,-82.68 --draught 0.5 --air-draught 2 --open 0-1.8 --output run/pictures/pelee \
		--picture docs/pictures/no-go.png
	PYTHONPATH=. $(BIN)/python -m bench.uphill docs/pictures/payload-uphill.png
	$(BIN)/python -m tests.guest.figure_2_9 docs/pictures/figure-2-9.png
	PYTHONSAFEPATH= $(BIN)/python -m tests.services.pictures docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.scenes docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.sheet docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_first_voyage docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_lake docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_dangers_page docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_charts_dropped docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_replayed_encounter docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_survey_page docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_gaps_page docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_divided_page docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_stations_page docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_glance docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_alerts_page docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_bridge_page docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_panes docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_adopt_page docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_adopted_whole docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_depths docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_payload_page docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_newboat_page docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.test_energy_page docs/pictures
	PYTHONSAFEPATH= $(BIN)/python -m tests.console.moving_picture docs/pictures/voyage.gif

bench: $(READY) ## measure the contracts of the design on this machine
	PYTHONPATH=. $(BIN)/python -m bench $(ARGS)

image: $(READY) ## build the boat's image, kernel and initramfs, into run/image (ARGS="--arch arm64", "--sign KEY")
	$(BIN)/python docker/image.py run/image $(ARGS)

deb: $(READY) ## build the Debian packages, into run/deb (ARGS="--debian 13 --arch arm64", --try installs them in a new root)
	PYTHONSAFEPATH= $(BIN)/python docker/deb.py run/deb $(ARGS)

wheel: $(BOAT) ## make the wheel of this checkout as it is, into dist; it needs no tag
	@rm -rf build
	@$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir dist .
	@ls dist/*.whl

release: $(READY) requirements/release.txt ## make the wheel and the source package of the tagged commit, into dist (ARGS="--sign KEY")
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements/release.txt
	@$(BIN)/python .ci/release.py $(ARGS)

audit: $(READY) requirements/audit.txt ## ask for known vulnerabilities of each pinned package that is shipped; it fails where one cannot be asked about
	@$(BIN)/python -m venv $(VENV)/audit
	@$(VENV)/audit/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements/audit.txt
	$(VENV)/audit/bin/pip-audit --strict --require-hashes --disable-pip --progress-spinner off $(addprefix -r ,$(LOCKS)) $(ARGS)

guest-shell: $(READY) system ## a shell in the kernel with CAN that the guest tests use
	$(BIN)/python tests/guest/harness.py

system: ## install the Debian packages of the guest tests where that is possible
	@missing=; for program in $(SYSTEM_PROGRAMS); do command -v $$program >/dev/null || missing="$$missing $$program"; done; \
	if [ -z "$$missing" ]; then exit 0; fi; \
	if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		export DEBIAN_FRONTEND=noninteractive; \
		{ apt-get update -qq && apt-get install -qq -y --no-install-recommends $(SYSTEM_PACKAGES); } </dev/null >/dev/null && exit 0; \
		why="apt-get failed"; \
	else why="installing them needs root and apt-get"; fi; \
	echo "make system: without$$missing some tests do not run ($$why; Debian packages: $(SYSTEM_PACKAGES))" >&2

formats: $(MORE) ## install the packages for Parquet, MF4, campaigns, Foxglove, brokers and ROS 2, 480 MB, and MAVProxy; the tests need them

lock: $(READY) ## pin and hash the packages of pyproject.toml again (ARGS=--upgrade takes the newest)
	$(call compile,boat) pyproject.toml
	$(call compile,services) --extra services -c requirements/boat.txt pyproject.toml
	$(call compile,ground) --extra ground -c requirements/boat.txt pyproject.toml
	$(call compile,test) --extra test -c requirements/boat.txt -c requirements/ground.txt pyproject.toml
	$(call compile,formats) --extra formats -c requirements/boat.txt -c requirements/ground.txt pyproject.toml
	$(call compile,campaign) --extra campaign -c requirements/boat.txt -c requirements/ground.txt -c requirements/formats.txt pyproject.toml
	$(call compile,foxglove) --extra foxglove -c requirements/boat.txt pyproject.toml
	$(call compile,ros) --extra ros -c requirements/boat.txt pyproject.toml
	$(call compile,fleet) --extra fleet -c requirements/boat.txt -c requirements/ground.txt pyproject.toml
	$(call compile,webrtc) --extra webrtc -c requirements/boat.txt -c requirements/ground.txt -c requirements/test.txt pyproject.toml
	$(call compile,build) requirements/build.in
	$(call compile,page) requirements/page.in
	$(call compile,site) -c requirements/boat.txt -c requirements/ground.txt -c requirements/campaign.txt -c requirements/test.txt \
		-c requirements/release.txt requirements/site.in
	$(call compile,release) -c requirements/boat.txt -c requirements/ground.txt -c requirements/formats.txt requirements/release.in
	$(call compile,audit) requirements/audit.in
	$(call compile,charts) --extra charts $(addprefix -c requirements/,$(addsuffix .txt,boat ground test release)) pyproject.toml
	$(call compile,readers) $(addprefix -c requirements/,$(addsuffix .txt,boat ground test charts formats campaign foxglove fleet ros mavproxy release)) \
		requirements/readers.in
compile = $(BIN)/pip-compile --quiet --generate-hashes --allow-unsafe --strip-extras --no-header --no-emit-index-url \
	--no-emit-trusted-host --no-emit-find-links $(ARGS) --output-file requirements/$(1).txt

clean: ## remove everything that was made here
	rm -rf .venv .venv-newest build dist run $(WEB)/node_modules *.egg-info .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

# All that a boat, its simulation and the console need; what tests, types and style need comes on top of it.
$(BOAT): $(LOCKS) pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
		{ echo "Delfim needs Python 3.11 or newer, and $(PYTHON) is $$($(PYTHON) -V 2>&1). Say: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || \
		{ echo "$(PYTHON) cannot make a virtual environment; on Debian install the package python3-venv" >&2; rm -rf $(VENV); exit 1; }
	@echo "make: installing the packages of Delfim into $(VENV), once; this takes about a minute"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps $(addprefix -r ,$(LOCKS))
	@PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

$(READY): $(BOAT) requirements/test.txt
	@echo "make: installing the packages of tests and checks into $(VENV), once; this takes two or three minutes"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements/test.txt
	@touch $@

# The page's tools come with npm: the machine's, or else the one that is on PyPI.
$(NPM): $(WEB)/package-lock.json $(READY)
	command -v npm >/dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements/page.txt
	cd $(WEB) && npm ci --ignore-scripts --no-audit --no-fund --silent
	@touch $@

# What a run needs, in the builds for other versions of Python: the same seed must sail the same way on each.
$(OTHERS): $(READY) requirements/boat.txt
	for version in 3.11 3.12 3.13 3.14; do $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps \
		--only-binary :all: --python-version $$version --target $(VENV)/builds/$$version --upgrade -r requirements/boat.txt || exit 1; done
	@touch $@

# Codecs for WebRTC, which are GPL: in a folder of their own, which no other test has on its path.
$(FILM): $(READY) requirements/webrtc.txt
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps --target $(VENV)/webrtc --upgrade \
		-r requirements/webrtc.txt
	@touch $@

# Two scripts of the site are npm's; their packages are held by their hashes.
$(MANUAL): $(BOAT) requirements/site.txt manual/scripts.lock
	@command -v npm >/dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements/page.txt
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements/site.txt
	@rm -rf $(VENV)/scripts && mkdir $(VENV)/scripts && cp manual/scripts.lock $(VENV)/scripts
	@cd $(VENV)/scripts && npm pack --silent $$(sed 's/.*  \(.*\)-\(.*\)\.tgz/\1@\2/' scripts.lock) >/dev/null && sha512sum --check --quiet scripts.lock
	@touch $@

$(MORE): $(READY) requirements/charts.txt requirements/formats.txt requirements/campaign.txt requirements/foxglove.txt requirements/fleet.txt requirements/ros.txt requirements/mavproxy.txt requirements/release.txt requirements/readers.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps $(patsubst %,-r %,$(filter %.txt,$^))
	@touch $@

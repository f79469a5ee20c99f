# make demo      track the sample recording, and say where to look
# make test      all tests; with other cameras and ROS 2, too: make test FEATURES=genicam,gstreamer,ros2
# make examples  run the programs in examples/
# make lint      formatting and lints, as CI checks them
# make bench     measure speed beside OpenCV and the bare decoder; writes benches/RESULTS.md
# make accuracy  errors against the truth of the sample recordings, in tables
# make paper     the paper's experiment with a simulated catheter, as a page; two circles also as rendered pictures
# make paper-fast  the same without pictures and with short chirps, in seconds

CARGO ?= cargo
DEMO := out/demo
VENV := target/venv
BROWSER ?= /usr/bin/chromium
FEATURES ?=
WITH := $(if $(FEATURES),--features $(FEATURES))

.PHONY: demo test examples lint bench accuracy paper paper-fast deps

# Cargo finds the program it has built, wherever the user's settings put it.
demo: deps
	$(CARGO) build --locked --release --bin catoptra
	@echo
	@$(CARGO) run --quiet --locked --release --bin catoptra -- track sample_frames/planar.mkv --rig calibration/dev_tank/rig.toml -o $(DEMO) --overlay
	@echo
	@echo "Open these:"
	@echo "  $(CURDIR)/$(DEMO)/report.html"
	@echo "  $(CURDIR)/$(DEMO)/overlay.mp4"

# With CATOPTRA_PYTHON set, the tests that read logs with other people's code must run; without it they may be left out.
# With CATOPTRA_BROWSER, so must the one that tries the studio's page.
test: deps
	@if command -v python3 >/dev/null; then $(MAKE) --no-print-directory $(VENV)/ready; fi
	@if [ -e $(VENV)/ready ]; then export CATOPTRA_PYTHON="$(CURDIR)/$(VENV)/bin/python"; fi; \
	if [ -x "$(BROWSER)" ] && $(VENV)/bin/python -c 'import playwright' 2>/dev/null; then export CATOPTRA_BROWSER="$(BROWSER)"; fi; set -x; $(CARGO) test --locked $(WITH)

examples: deps
	$(CARGO) run --quiet --locked $(WITH) --example track_video -- sample_frames/planar.mkv calibration/dev_tank/rig.toml
	$(CARGO) run --quiet --locked $(WITH) --example frame_source
	$(CARGO) run --quiet --locked $(WITH) --example read_log

lint: deps
	$(CARGO) fmt --check
	$(CARGO) clippy --locked --all-targets -- -D warnings

bench: deps
	CARGO="$(CARGO)" scripts/bench

accuracy: deps
	$(CARGO) test --locked --test it accuracy:: -- --nocapture --test-threads 1

paper paper-fast: deps
	$(CARGO) build --locked --release --bin catoptra
	scripts/paper.py --catoptra "$$($(CARGO) metadata --format-version 1 --no-deps --locked | python3 -c 'import json,sys; print(json.load(sys.stdin)["target_directory"])')/release/catoptra" \
	  $(if $(filter paper-fast,$@),--fast,--pictures 5,20) -o out/$@

deps:
	@scripts/install-deps

# Made again when what it needs has changed.
$(VENV)/ready: Makefile
	python3 -m venv $(VENV)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check mcap mcap-protobuf-support mcap-ros2-support rosbags websockets numpy scipy
	@# What reads tables and listens to DDS; large, as wheels only, and their tests say so when they are missing.
	@$(VENV)/bin/pip install --quiet --disable-pip-version-check --only-binary :all: pyarrow polars || echo "without pyarrow and polars"
	@$(VENV)/bin/pip install --quiet --disable-pip-version-check --only-binary :all: cyclonedds || echo "without cyclonedds"
	@# A second source for identify; without it numpy and scipy compare alone. As wheels only: they are built from Fortran otherwise.
	@$(VENV)/bin/pip install --quiet --disable-pip-version-check --only-binary :all: control slycot || echo "without python-control and slycot"
	@# Drives a browser that is there already; it has no wheel for every machine.
	@$(VENV)/bin/pip install --quiet --disable-pip-version-check --only-binary :all: playwright || echo "without playwright"
	@touch $@

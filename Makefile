# The two commands are `make demo` and `make test`; `make` alone lists all of them.

# A folder with recording/, scene/ and truth/, and where its results go.
SEQUENCE ?= tests/data/moving_lamp
OUT ?= out/demo

TARGET_DIR := $(or $(CARGO_TARGET_DIR),target)
BIN := $(TARGET_DIR)/release

# Where this is not set (a container, say), Mesa prints an error that is none. Any folder will do.
export XDG_RUNTIME_DIR ?= /tmp

.PHONY: help demo test test-drivers bench-probe bench-shadows shadow-table gallery bench-calibration setup build lint docs

help:
	@echo 'make demo    set up, build, render the recording in $(SEQUENCE), write pictures and figures to $(OUT)'
	@echo 'make test    set up and run all tests'
	@echo 'make test-drivers   run the tests on real camera drivers, in a virtual machine'
	@echo 'make bench-probe    light against truth, for tests/data and SEQUENCES="FOLDER ..."; time and error of its maps'
	@echo 'make bench-shadows  time and error of every shadow method, plots and a contact sheet in out/bench-shadows'
	@echo 'make shadow-table   every shadow method on tests/data or SEQUENCES="FOLDER ...", against truth'
	@echo 'make gallery        our composites beside phone-style light and the references, tests/data or SEQUENCES="FOLDER ..."'
	@echo 'make bench-calibration   lenses by us, and by OpenCV and mrcal where they are installed; PHOTOS=DIR for real pictures'
	@echo 'make setup   install what Debian packages are missing; check the Rust toolchain'
	@echo 'make build   build all programs'
	@echo 'make lint    check format, lints, documentation and, with cargo-deny, licences and advisories'
	@echo 'make docs    build the documentation of all crates'

setup:
	@scripts/setup.sh

build: setup
	cargo build --release --locked --workspace --bins

demo: setup build
	$(BIN)/mirrorball-render --recording '$(SEQUENCE)/recording' --scene '$(SEQUENCE)/scene/scene.toml' \
		--out '$(OUT)' --environment-out
	$(BIN)/sheet '$(OUT)' '$(SEQUENCE)/recording' --truth '$(SEQUENCE)/truth' \
		--out '$(OUT)/sheet.png' --preview '$(OUT)/preview.gif'
	$(BIN)/score '$(OUT)' '$(SEQUENCE)/truth' --json '$(OUT)/score.json'
	@echo
	@echo 'contact sheet   $(OUT)/sheet.png'
	@echo 'animation       $(OUT)/preview.gif'
	@echo 'composites      $(OUT)/composite/'
	@echo 'measured light  $(OUT)/environment/'
	@echo 'frame by frame  $(OUT)/frames.jsonl'
	@echo 'these figures   $(OUT)/score.json'

# After set-up there is a Vulkan adapter, lavapipe if nothing else, so a test that skips for want of one is a failure.
test: setup
	MIRRORBALL_REQUIRE_GPU=1 cargo test --release --locked --workspace

# The same tests on real kernel drivers that `make test` runs among the others. Cases are chosen with
# MIRRORBALL_DRIVER_CASES='name name'.
test-drivers: setup
	cargo build --release --locked -p mirrorball-capture -p mirrorball-calib -p mirrorball-driver-tests
	MIRRORBALL_REQUIRE_DRIVERS=1 cargo test --release --locked -p mirrorball-driver-tests -- --nocapture

# Accuracy of the measured light on recordings with truth, and time and error of the maps made of it, beside their peers.
bench-probe: setup build
	@scripts/bench-probe.sh

# Every shadow method on this machine's adapter: time beside the seeds' figures, error, growth, contact sheet.
# ARGS="--quick --only maps,errors" for less.
bench-shadows: setup
	@scripts/bench-shadows.sh $(ARGS)

# Every shadow method in the camera's picture, against truth: with the measured light, and with the true map.
shadow-table: setup
	@scripts/shadow-table.sh $(or $(SEQUENCES),tests/data/moving_lamp tests/data/two_cameras tests/data/fisheye)

# Our composites beside those lit as phones do it and beside the path-traced references; picture and table in out/gallery.
gallery: setup
	@scripts/gallery.sh $(or $(SEQUENCES),tests/data/moving_lamp tests/data/two_cameras tests/data/fisheye)

# Lenses from the same corners by us and by peers (Python with OpenCV, mrcal), which are optional. PHOTOS=DIR, SEEDS=N.
bench-calibration: setup
	@scripts/bench-calibration.sh

lint:
	cargo fmt --all --check
	cargo clippy --release --locked --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS='-D warnings' cargo doc --release --locked --workspace --no-deps
	@if cargo deny --version >/dev/null 2>&1; then cargo deny --locked check; \
		else echo 'cargo-deny is not installed: licences and advisories not checked'; fi

docs:
	cargo doc --release --locked --workspace --no-deps
	@echo 'open $(TARGET_DIR)/doc/mirrorball_render/index.html'

# What a person repeats. `just` lists it.

_default:
    @just --list

# The command, optimised
build:
    cargo build --release --locked --package uw-cli

# Formatting, lints, tests, documentation
test:
    ./test.sh

# The main job on the fixtures, beside the truth
demo:
    ./demo.sh

lint:
    cargo clippy --workspace --all-targets --locked -- -D warnings

fmt:
    cargo fmt --all

# Criterion benches, each with its comparison in the same run
bench *FILTER:
    cargo bench --locked --bench '*' -- {{FILTER}}

# Every calibrated figure's scatter against its predicted sigma
monte-carlo TRIALS="200":
    UWSCAN_TRIALS={{TRIALS}} cargo test --locked --package uw-calib --test joint accuracy -- --nocapture

# How time and memory of trees, normals, outliers, thinning, meshes and shapes grow from ten thousand to ten million points: denser, or with `larger` on a larger scene
clouds-scale *ARGS:
    cargo run --release --locked --package uw-cloud --example cloud_scale -- {{ARGS}}

# How often 95 % intervals of radii and distances hold the truth, the instrument drawn anew for each artefact
coverage ARTEFACTS="1000":
    UWSCAN_ARTEFACTS={{ARTEFACTS}} cargo test --locked --package uwscan --test it intervals_hold -- --nocapture

# Stripe methods by the speed of a pure read, image by image in turn (benches/README.md says how to read it)
stripe-ratios:
    cargo bench --locked --bench stripes -- --ratios

# Every stripe method's errors by the Cramér–Rao bound, on scenes of known truth
stripe-accuracy SEEDS="4" *SCENES:
    cargo run --release --locked --package uw-stripe --example accuracy -- {{SEEDS}} {{SCENES}}

# Fails where the compiler left vector operations of the stripe kernels outside the processor's features (docs/adr/0009)
stripe-outlined:
    cargo build --release --locked --package uw-stripe --example speed
    ! nm --demangle target/release/examples/speed | grep __fearless_simd_kernel

# Recording, extraction and triangulation together against disk, memory and bare queues in the same run; MEMORY is a tmpfs
record-speed CALIBRATION DISK="." MEMORY="/dev/shm" FRAMES="2000":
    cargo run --release --locked --example record_speed -- {{CALIBRATION}} {{DISK}} {{MEMORY}} {{FRAMES}}

# The stripe kernels as aarch64 code (NEON) under qemu-user, for correctness
neon:
    scripts/neon.sh

# Random images and settings through every stripe method (needs cargo-fuzz). There is no unsafe code whose faults only a nightly toolchain's sanitizers would find
fuzz SECONDS="60":
    cd crates/uw-stripe && cargo fuzz run --sanitizer none extract -- -max_total_time={{SECONDS}}

# The paper's experiments, simulated, by its method and by ours
reproduce FOLDER="target/reproduce" *ARGS: build
    target/release/uwscan reproduce -o {{FOLDER}} --force {{ARGS}}

# Pages of reports in headless Chromium: no fault on the console, nothing asked of the network, views turn; pictures go into FOLDER
pages FOLDER *PAGES:
    scripts/pages.sh {{FOLDER}} {{PAGES}}

# The live page: types, tests, build compared with the committed files, headless Chromium; `just page --update` writes the built files
page *FLAGS:
    scripts/live-page.sh {{FLAGS}}

# An acceptance script of yours (SCRIPT --uwscan BINARY …) on the optimised command
accept SCRIPT *ARGS: build
    {{SCRIPT}} --uwscan {{justfile_directory()}}/target/release/uwscan {{ARGS}}

# What 20 viewers and a stuck one cost a scan at 200 Hz, by one without them in the same run; on an idle machine
live-load CALIBRATION *ARGS:
    cargo run --release --locked --features live --example live_load -- {{CALIBRATION}} {{ARGS}}

# A live scan before clients that are not ours (Python: websockets, protobuf)
live:
    scripts/live.sh

# Recordings before readers that are not ours (Python: mcap, rosbags, pymcap-cli)
recordings:
    scripts/recordings.sh

# Clouds and meshes before readers that are not ours
clouds:
    scripts/clouds.sh

# Speed of recording beside that of the bare disk (or memory: /dev/shm), MB/s
recording-speed FOLDER="/dev/shm":
    cargo run --release --locked --package uw-io --example recording_speed -- {{FOLDER}}

# Compares the fixtures with their recorded hashes; `just fixtures --update` records them anew
fixtures *FLAGS:
    fixtures/check.sh {{FLAGS}}

# The libraries' documentation, opened in the browser
docs:
    cargo doc --workspace --no-deps --locked --open

# Makes the pictures in README again (needs Python with numpy, matplotlib and pillow; Node with the live page's packages, and Chromium)
pictures:
    mkdir -p target/picture
    cargo run --release --locked --package uw-cli -- calibrate fixtures/cal-air fixtures/cal-water -o target/picture/calibration.toml --force
    cargo run --release --locked --package uw-cli -- reconstruct fixtures/cover -c target/picture/calibration.toml -o target/picture/cover.ply --force
    python3 docs/images/overview.py
    cargo run --release --locked --package uw-cli -- demo -o target/picture/demo --force
    cd crates/uw-live/page && npm ci --ignore-scripts
    node docs/images/live.mjs target/release/uwscan target/picture/demo/vehicle.toml docs/images/live.png

# The Python package: build, lints, tests
python:
    scripts/python.sh

# The Python module's type stubs, written anew from the Rust sources
stubs:
    scripts/python.sh stubs

# Two hundred recordings through Dask, one torn, one worker killed
archive *ARGS:
    scripts/python.sh archive {{ARGS}}

# The documentation's site, in target/docs/site
site *ARGS:
    scripts/docs.sh {{ARGS}}

# Calls from Python beside the same work in Rust, OpenCV and NumPy in the same run
python-speed CALIBRATION:
    .venv/bin/python benches/peers/python.py {{CALIBRATION}}

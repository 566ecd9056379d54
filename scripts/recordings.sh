#!/usr/bin/env bash
# Recordings before readers that are not ours: the Python packages mcap, mcap-protobuf-support, rosbags and pymcap-cli; a calibration's camera
# before PyYAML and OpenCV. Skips itself, saying so, where they can't be had.
set -euo pipefail
cd "$(dirname "$0")/.."

. scripts/toolchain.sh
. scripts/packages.sh

packages "${UWSCAN_VENV:-}" pymcap-cli "read recordings" \
    'mcap>=1.2' 'mcap-protobuf-support>=0.5' 'pymcap-cli>=0.5' 'rosbags>=0.10' numpy pillow pyyaml opencv-python-headless
PATH=$venv/bin:$PATH
cargo build --release --locked --quiet --package uw-cli --bin uwscan
cargo build --release --locked --quiet --package uw-io --example record
uwscan=${CARGO_TARGET_DIR:-target}/release/uwscan
[ -n "${UWSCAN_CALIBRATION:-}" ] ||
    "$uwscan" calibrate fixtures/cal-air fixtures/cal-water -o "$work/calibration.toml" --quiet >/dev/null
"${CARGO_TARGET_DIR:-target}/release/examples/record" "$work/example.mcap" "${UWSCAN_CALIBRATION:-$work/calibration.toml}"
"$uwscan" convert fixtures/ball "$work/ball.mcap"
"$uwscan" convert --to ros2 "$work/example.mcap" "$work/bag"
head -c "$(($(stat -c %s "$work/ball.mcap") * 2 / 3))" "$work/ball.mcap" >"$work/torn.mcap"
"$uwscan" recover "$work/torn.mcap" -o "$work/recovered.mcap" || [ $? = 3 ]
calibration=${UWSCAN_CALIBRATION:-$work/calibration.toml}
for to in ros opencv; do "$uwscan" convert "$calibration" "$work/$to.yaml" --to "$to"; done
python scripts/cameras.py "$calibration" "$work/ros.yaml" "$work/opencv.yaml"
python scripts/recordings.py "$work/example.mcap" "$work/ball.mcap" "$work/bag" "$work/recovered.mcap"

#!/usr/bin/env bash
# A whole job with nothing but this repository: build uwscan, then let it calibrate a simulated instrument, scan with it, measure, and
# compare with the truth. What it made goes to target/demo.
set -euo pipefail
cd "$(dirname "$0")"

. scripts/toolchain.sh

echo "== Building uwscan (optimised; a few minutes the first time, seconds after that)"
cargo build --release --locked --package uw-cli
uwscan=${CARGO_TARGET_DIR:-target}/release/uwscan
out=target/demo
mkdir -p target
# What an earlier version of this script left there is no output of the demo.
[ -e "$out/calibration.toml" ] || rm -rf "$out"

printf '\n== The demo\n$ uwscan demo -o %s --force\n' "$out"
"$uwscan" demo -o "$out" --force
echo "Any viewer of PLY shows $out/ball.ply and $out/cover.ply."

#!/usr/bin/env bash
# The main job on the captures in fixtures/: calibrate the instrument, scan in water, measure a ball, compare with the truth.
# Everything it writes goes to target/demo.
set -euo pipefail
cd "$(dirname "$0")"

. scripts/toolchain.sh

echo "== Building uwscan (optimised; a few minutes the first time, seconds after that)"
cargo build --release --locked --package uw-cli
uwscan=${CARGO_TARGET_DIR:-target}/release/uwscan
out=target/demo
mkdir -p "$out"

step() {
    printf '\n== %s\n$ uwscan %s\n' "$1" "${*:2}"
    "$uwscan" "${@:2}"
}

# number KEY JSON-FILE: a number from what --json printed.
number() {
    tr -d ' \n' <"$2" | grep -oE "\"$1\":[-+0-9.eE]+" | head -n 1 | cut -d: -f2
}

step "Calibrating from 15 placements of a chessboard in air and 10 in water" \
    calibrate fixtures/cal-air fixtures/cal-water -o "$out/calibration.toml" --force

for scan in ball three-ball cover; do
    step "Reconstructing $scan" reconstruct "fixtures/$scan" -c "$out/calibration.toml" -o "$out/$scan.ply" --force
done

step "Fitting a sphere to the ball" fit sphere "$out/ball.ply"
"$uwscan" fit sphere "$out/ball.ply" --json >"$out/ball.json" 2>"$out/ball.log"

found=$(number radius_mm "$out/ball.json")
sigma=$(number sigma_radius_mm "$out/ball.json")
truth=$(awk -F, '$1 == "ball" { print $3 }' fixtures/truth.csv)
echo
awk -v found="$found" -v sigma="$sigma" -v truth="$truth" -v bar=0.03 'BEGIN {
    error = found - truth
    printf "The ball'"'"'s radius: %.4f mm found (sigma %.4f), %.4f mm true, %+.4f mm off\n", found, sigma, truth, error
    if (error > bar || error < -bar) { printf "FAILED: more than %g mm off\n", bar; exit 1 }
}'
echo "Clouds and calibration are in $out; any viewer of PLY shows them."

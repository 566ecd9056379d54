#!/usr/bin/env bash
# A live scan before readers that are not ours: Foxglove's stream and the page's, by the Python packages websockets and protobuf. Skips itself,
# saying so, where they can't be had.
set -euo pipefail
cd "$(dirname "$0")/.."

. scripts/toolchain.sh
. scripts/packages.sh

packages "${UWSCAN_LIVE_VENV:-}" python "read streams" 'websockets>=13' 'protobuf>=5'
if [ -z "${UWSCAN:-}" ]; then
    cargo build --release --locked --quiet --package uw-cli --bin uwscan
    UWSCAN=${CARGO_TARGET_DIR:-target}/release/uwscan
fi
# A whole simulated vehicle with its calibration, then its scan of a ball as an instrument: that takes no time to simulate.
demo=${UWSCAN_DEMO:-$work/demo}
[ -e "$demo/vehicle.toml" ] || "$UWSCAN" demo -o "$demo" --quiet >/dev/null
sed -e 's/"simulated"/"replay"/' -e '/^scene/d' -e 's|^rig .*|rig = "'"$demo"'/rig.toml"|' -e '/^calibration/d' \
    -e 's|^width  |id = "'"$demo"'/ball"\nwidth|' "$demo/vehicle.toml" >"$work/vehicle.toml"
"$venv/bin/python" scripts/live.py "$UWSCAN" "$work/vehicle.toml" "$demo/calibration.toml"

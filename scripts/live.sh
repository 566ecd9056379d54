#!/usr/bin/env bash
# A live scan before readers that are not ours: Foxglove's stream and the page's, by the Python packages websockets and protobuf. Skips itself,
# saying so, where they can't be had.
set -euo pipefail
cd "$(dirname "$0")/.."

. scripts/toolchain.sh

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
venv=${UWSCAN_LIVE_VENV:-$work/venv}
if [ ! -x "$venv/bin/python" ]; then
    if ! { python3 -m venv "$venv" && "$venv/bin/pip" install --quiet --disable-pip-version-check \
        'websockets>=13' 'protobuf>=5'; } >"$work/pip.log" 2>&1; then
        echo "skipped: no Python packages to read streams with ($(tail -n 1 "$work/pip.log"))"
        exit 0
    fi
fi
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

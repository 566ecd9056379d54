#!/usr/bin/env bash
# Clouds and meshes before readers that are not ours: the Python packages plyfile, pypcd4, laspy, pye57 and trimesh. Skips itself, saying so, where
# they can't be had.
set -euo pipefail
cd "$(dirname "$0")/.."

. scripts/toolchain.sh
. scripts/packages.sh

packages "${UWSCAN_CLOUD_VENV:-}" python "read clouds" 'plyfile>=1.0' 'pypcd4>=1.0' 'laspy[lazrs]>=2.5' 'pye57>=0.4' 'trimesh>=4.4' numpy
cargo build --release --locked --quiet --package uw-io --features las --example clouds
"${CARGO_TARGET_DIR:-target}/release/examples/clouds" "$work"
"$venv/bin/python" scripts/clouds.py "$work"

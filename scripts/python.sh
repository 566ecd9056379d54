#!/usr/bin/env bash
# The Python package: builds it into a virtual environment, and runs lints and tests. Skips itself, saying so, where its packages
# can't be had. UWSCAN_PROFILE=dev builds without optimisation of the last degree.
set -euo pipefail
cd "$(dirname "$0")/.."

. scripts/toolchain.sh

root=$PWD
venv=${UWSCAN_VENV:-$root/.venv}
if ! { [ -x "$venv/bin/python" ] || python3 -m venv "$venv"; } ||
    ! "$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
        'maturin>=1.9,<2' 'numpy>=1.26' 'matplotlib>=3.8' 'hypothesis>=6' 'pytest>=8' \
        'dask[distributed]>=2024.1' 'pyarrow>=14' pandas xarray; then
    echo "skipped: no Python packages to build and test with"
    exit 0
fi
export VIRTUAL_ENV=$venv PATH=$venv/bin:$PATH CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$root/target}
profile=${UWSCAN_PROFILE:-release}

step() {
    printf '\n== %s\n$ %s\n' "$1" "${*:2}"
    "${@:2}"
}

step "Formatting" cargo fmt --manifest-path python/Cargo.toml --check
step "Lints" cargo clippy --manifest-path python/Cargo.toml
step "Build" maturin develop --profile "$profile"
step "Tests" python -m pytest -q

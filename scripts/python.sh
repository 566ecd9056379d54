#!/usr/bin/env bash
# The Python package: builds it into a virtual environment, and runs lints, type checks and tests. Skips itself, saying so, where its packages
# can't be had. UWSCAN_PROFILE=release builds with optimisation of the last degree, to time it. `scripts/python.sh stubs` writes the type stubs anew;
# `scripts/python.sh archive` puts an archive of two hundred recordings through Dask, with a torn one and a killed worker.
set -euo pipefail
cd "$(dirname "$0")/.."

. scripts/toolchain.sh

root=$PWD
venv=${UWSCAN_VENV:-$root/.venv}
if ! { [ -x "$venv/bin/python" ] || python3 -m venv "$venv"; } ||
    ! "$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
        'maturin>=1.16,<2' 'numpy>=1.26' 'matplotlib>=3.8' 'hypothesis>=6' 'pytest>=8' \
        'dask[distributed]>=2024.1' 'pyarrow>=14' pandas xarray 'mypy>=1.15' pyright; then
    echo "skipped: no Python packages to build and test with"
    exit 0
fi
export VIRTUAL_ENV=$venv PATH=$venv/bin:$PATH CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$root/target}
profile=${UWSCAN_PROFILE:-dev}

step() {
    printf '\n== %s\n$ %s\n' "$1" "${*:2}"
    "${@:2}"
}

# Into a folder of its own: what is kept is that, mended (scripts/stubs.py). By the dev profile, which strips no symbols.
stubs() {
    local made
    made=$(mktemp -d)
    python -m maturin generate-stubs --quiet --manifest-path python/Cargo.toml --profile dev --features stubs --out "$made"
    python scripts/stubs.py "$made" "$@"
    rm -r "$made"
}

case ${1:-} in
stubs)
    stubs
    exit
    ;;
archive)
    shift
    step "Build" python -m maturin develop --profile "$profile"
    step "Archive" python scripts/archive.py "$@"
    exit
    ;;
esac

step "Formatting" cargo fmt --manifest-path python/Cargo.toml --check
step "Lints" cargo clippy --manifest-path python/Cargo.toml -- -D warnings
# With what the stubs are read off: one build is both.
step "Build" python -m maturin develop --profile "$profile" --features stubs
step "Stubs" stubs --check
step "Stubs beside the module" python -m mypy.stubtest uwscan._uwscan
step "Types, mypy" python -m mypy
step "Types, pyright" python -m pyright
step "Tests" python -m pytest -q

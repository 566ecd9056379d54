#!/usr/bin/env bash
# All tests: formatting, lints, the test suite, the documentation. With UWSCAN_FEATURES=uw-cli/genicam,uw-cli/v4l2 the drivers of cameras
# that nobody needs to have are built and tested, too.
set -euo pipefail
cd "$(dirname "$0")"

. scripts/toolchain.sh

features=--features=${UWSCAN_FEATURES-}

step() {
    printf '\n== %s\n$ %s\n' "$1" "${*:2}"
    "${@:2}"
}

step "Formatting" cargo fmt --all --check
step "Lints" cargo clippy --workspace --all-targets --locked "$features" -- -D warnings
step "Tests" cargo test --workspace --locked "$features"
export RUSTDOCFLAGS="-D warnings"
step "Documentation" cargo doc --workspace --no-deps --locked "$features"
printf '\nAll tests passed.\n'

#!/usr/bin/env bash
# All tests: formatting, lints, the test suite, the documentation.
set -euo pipefail
cd "$(dirname "$0")"

. scripts/toolchain.sh

step() {
    printf '\n== %s\n$ %s\n' "$1" "${*:2}"
    "${@:2}"
}

step "Formatting" cargo fmt --all --check
step "Lints" cargo clippy --workspace --all-targets --locked -- -D warnings
step "Tests" cargo test --workspace --locked
export RUSTDOCFLAGS="-D warnings"
step "Documentation" cargo doc --workspace --no-deps --locked
printf '\nAll tests passed.\n'

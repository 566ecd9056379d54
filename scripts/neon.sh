#!/usr/bin/env bash
# Runs the stripe kernels as aarch64 code, in NEON, under qemu-user: that they are right, not how fast they are.
# Needs qemu-user, gcc-aarch64-linux-gnu and libc6-dev-arm64-cross (Debian's names), and rustup.
set -euo pipefail
cd "$(dirname "$0")/.."

. scripts/toolchain.sh

target=aarch64-unknown-linux-gnu
rustup target add "$target"
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="qemu-aarch64 -L /usr/aarch64-linux-gnu"
test=(cargo test --package uw-stripe --target "$target" --locked)
# Every level of NEON against the scalar one, bit for bit, of all methods; then what was recorded on x86-64.
"${test[@]}" --lib
"${test[@]}" --test it -- processors

# Sourced by the commands of README: finds Rust and a linker, or says how to get them. Installs nothing that needs root.

if ! command -v cargo >/dev/null && [ -f "${CARGO_HOME:-$HOME/.cargo}/env" ]; then
    . "${CARGO_HOME:-$HOME/.cargo}/env"
fi
if ! command -v cargo >/dev/null; then
    cat >&2 <<'SAY'
Rust is missing. Get it, for this user only, with
    curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs | sh
or see https://rustup.rs, then run this again.
SAY
    exit 1
fi
if ! command -v cc >/dev/null; then
    cat >&2 <<'SAY'
A C compiler is missing (Rust links with it). On Debian or Ubuntu:
    sudo apt-get install gcc libc6-dev
On macOS: xcode-select --install
SAY
    exit 1
fi

# The Rust that rust-toolchain.toml pins; rustup fetches it where it is not there yet.
if command -v rustup >/dev/null; then
    toolchain=$(sed -n 's/^channel *= *"\(.*\)"/\1/p' rust-toolchain.toml)
    if ! rustup run "$toolchain" rustc --version >/dev/null 2>&1; then
        echo "== Fetching Rust $toolchain with rustup"
        rustup toolchain install "$toolchain" --profile minimal --component clippy --component rustfmt
    fi
fi
echo "== Using $(cargo --version)"

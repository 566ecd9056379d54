#!/usr/bin/env bash
# Runs a command beside a fake GigE camera, both alone in a network namespace, because discovery broadcasts:
#     scripts/fake-camera.sh [option of arv-fake-gv-camera-0.8…] -- command…     Aravis's own, which shows a ramp
#     scripts/fake-camera.sh --sees FILE -- command…                             ours, which shows what FILE holds (fake-camera.c)
# The camera is at 127.0.0.1, its process in UWSCAN_FAKE_CAMERA. Ends with the command's code; with 77, saying why, where this machine can't.
set -euo pipefail

options=()
while [ $# -gt 0 ] && [ "$1" != -- ]; do options+=("$1"); shift; done
[ $# -gt 1 ] || { echo "usage: $0 [option…] -- command…" >&2; exit 2; }
shift

cannot() { echo "no fake camera here: $1" >&2; exit 77; }
[ "$(id -u)" = 0 ] || cannot "a network namespace needs root"
command -v ip >/dev/null || cannot "ip is missing (Debian: iproute2)"
if [ "${options[0]-}" = --sees ]; then
    pkg-config --exists aravis-0.8 || cannot "Aravis's headers are missing (Debian: libaravis-dev, pkg-config)"
    root=$(cd "$(dirname "$0")/.." && pwd)
    source=$root/scripts/fake-camera.c
    built=${CARGO_TARGET_DIR:-$root/target}/fake-camera
    if [ ! "$built" -nt "$source" ]; then
        mkdir -p "${built%/*}"
        # Put in place whole: tests that run beside each other may all build it.
        flags=$(pkg-config --cflags --libs aravis-0.8)
        # shellcheck disable=SC2086
        "${CC:-cc}" -O1 -Wall -Wextra -Werror -o "$built.$$" "$source" $flags
        mv "$built.$$" "$built"
    fi
    start=("$built" "${options[@]:1}")
else
    command -v arv-fake-gv-camera-0.8 >/dev/null || cannot "arv-fake-gv-camera-0.8 is missing (Debian: aravis-tools)"
    start=(arv-fake-gv-camera-0.8 -i 127.0.0.1 -s UW1 "${options[@]}")
fi

space="uwcam-$$"
ip netns add "$space" 2>/dev/null || cannot "network namespaces are not allowed"
camera=
finish() {
    [ -z "$camera" ] || kill "$camera" 2>/dev/null || true
    ip netns delete "$space" 2>/dev/null || true
}
trap finish EXIT
ip netns exec "$space" ip link set lo up
ip netns exec "$space" "${start[@]}" >/dev/null &
camera=$!
for _ in $(seq 100); do
    # GigE Vision's control port, 3956, is hexadecimal 0F74.
    if ip netns exec "$space" grep -qi ':0F74 ' /proc/net/udp; then break; fi
    kill -0 "$camera" 2>/dev/null || { echo "the fake camera ended at once" >&2; exit 1; }
    sleep 0.1
done
code=0
UWSCAN_FAKE_CAMERA=$camera ip netns exec "$space" "$@" || code=$?
exit "$code"

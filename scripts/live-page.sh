#!/usr/bin/env bash
# The live page (crates/uw-live/page): types, unit tests, build compared with the committed files, tests in headless Chromium against the mock and, with
# UWSCAN_BINARY=path/to/uwscan, against the program. `--update` writes the built files instead of comparing. Skips itself where there is no npm or Chromium.
set -euo pipefail
binary=${UWSCAN_BINARY:+$(realpath "$UWSCAN_BINARY")}
cd "$(dirname "$0")/../crates/uw-live/page"
command -v npm >/dev/null || { echo "live page: skipped, no npm (apt-get install npm)" >&2; exit 0; }
[ "$(node -p 'parseInt(process.versions.node)')" -ge 20 ] || { echo "live page: skipped, node $(node --version) is older than 20" >&2; exit 0; }
npm ci --silent --ignore-scripts
npm run --silent check
npm run --silent unit
if [ "${1-}" = --update ]; then
    npm run --silent build
else
    rm -rf out/built
    node build.mjs --out out/built
    diff -rq ../assets out/built || { echo "live page: ../assets is not what the sources give: scripts/live-page.sh --update" >&2; exit 1; }
fi
size=$(cat ../assets/* | wc -c)
echo "live page: $size bytes in all"
[ "$size" -le 1000000 ] || { echo "live page: larger than 1 MB" >&2; exit 1; }
if [ -z "${UWSCAN_CHROMIUM-}" ] && ! command -v chromium chromium-browser google-chrome >/dev/null; then
    echo "live page: its tests in a browser are skipped, no Chromium (apt-get install chromium)" >&2
    exit 0
fi
npm run --silent e2e
if [ -n "${UWSCAN_BINARY-}" ]; then UWSCAN_BINARY=$binary npm run --silent binary; else echo "live page: not tested with the program, UWSCAN_BINARY is not set" >&2; fi

#!/usr/bin/env bash
# Pages of reports in headless Chromium: scripts/pages.sh FOLDER PAGE.html… — nothing on the console, nothing asked of the network, the views in space
# turn, nothing wider than a phone; pictures in light, dark, print and at phone width go into FOLDER. Needs chromium and Python with venv;
# pdftoppm (poppler-utils) for the pictures of print.
set -euo pipefail
cd "$(dirname "$0")/.."
[ $# -ge 2 ] || { echo "usage: scripts/pages.sh FOLDER PAGE.html…" >&2; exit 2; }
chromium=$(command -v chromium || command -v chromium-browser || command -v google-chrome) ||
    { echo "no Chromium: apt-get install chromium" >&2; exit 1; }
python=${PAGES_VENV:-target/pages}/bin/python
[ -x "$python" ] || python3 -m venv "${python%/bin/python}"
"$python" -c 'import playwright' 2>/dev/null || "$python" -m pip install --quiet playwright
CHROMIUM=$chromium exec "$python" scripts/pages.py "$@"

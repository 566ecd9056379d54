#!/usr/bin/env bash
# The documentation's site, in target/docs/site: figures are made and notebooks executed by the code as it is; a link that leads nowhere is an error.
# Needs what scripts/python.sh has built. `scripts/docs.sh --no-notebooks` does not execute them.
set -euo pipefail
cd "$(dirname "$0")/.."

venv=${UWSCAN_VENV:-$PWD/.venv}
if ! "$venv/bin/python" -c 'import uwscan' 2>/dev/null; then
    echo "scripts/python.sh builds what this documents: run it first" >&2
    exit 1
fi
if ! "$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    'matplotlib>=3.8' 'mkdocs-material>=9.5,<10' 'mkdocstrings[python]>=0.27' 'nbconvert>=7' ipykernel; then
    echo "skipped: no packages to build the site with"
    exit 0
fi

# What is kept is without outputs: they belong to the site.
"$venv/bin/python" - docs/notebooks/*.ipynb <<'CHECK'
import json, sys

for path in sys.argv[1:]:
    cells = json.load(open(path))["cells"]
    if any(cell.get("outputs") or cell.get("execution_count") for cell in cells):
        sys.exit(f"{path}: holds outputs; clear them (jupyter nbconvert --clear-output --inplace {path})")
CHECK
"$venv/bin/python" scripts/docs.py "$@"
NO_MKDOCS_2_WARNING=1 "$venv/bin/python" -m mkdocs build --strict --quiet
# Pages must not ask for anything that is not there with them.
if grep -rEl --include='*.html' --exclude-dir=rust '<(script|link|img|iframe)[^>]+(src|href)="(https?:)?//' target/docs/site; then
    echo "the pages above ask for files from the network" >&2
    exit 1
fi
echo "target/docs/site/index.html"

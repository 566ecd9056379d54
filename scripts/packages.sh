# Sourced by the scripts that put our files before Python packages that are not ours. Makes `work`, a folder that is gone when the script ends.

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# packages VENV PROGRAM PURPOSE PACKAGE…: makes `venv` the virtual environment VENV, or one in `work` where VENV is empty, with the packages
# installed unless PROGRAM is in it already. Where they can't be had it says so, and ends the script: that is no failure.
packages() {
    venv=${1:-$work/venv}
    if [ -x "$venv/bin/$2" ]; then
        return
    fi
    if ! { python3 -m venv "$venv" && "$venv/bin/pip" install --quiet --disable-pip-version-check "${@:4}"; } >"$work/pip.log" 2>&1; then
        echo "skipped: no Python packages to $3 with ($(tail -n 1 "$work/pip.log"))"
        exit 0
    fi
}

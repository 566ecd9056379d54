"""Puts the generated type stubs of the compiled module right, and says whether the committed ones are those: python scripts/stubs.py GENERATED [--check]

What is changed, each with its reason, is below; all else is as maturin generates it (docs/adr/0050-type-stubs.md).
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

STUBS = Path(__file__).parents[1] / "python/uwscan/_uwscan.pyi"
HEAD = "# Generated from the Rust sources by `scripts/python.sh stubs`: change those.\n"


#: What annotations in the sources name by whole paths; only those that the generator knows of itself are imported by it.
IMPORTS = "import collections.abc\nimport os\nimport pathlib\nimport typing\nimport numpy.typing\n"
#: Annotations come quoted as they stand in the sources, which a stub need not do, and type checkers read Literals in quotes wrongly.
QUOTED = re.compile(r'(: |-> )"([^"]*)"')
#: Rust's dictionaries and lists do not say what is in them.
BARE = {
    "-> dict:": "-> dict[str, typing.Any]:",
    "-> dict | None:": "-> dict[str, typing.Any] | None:",
    "-> list:": "-> list[dict[str, typing.Any]]:",
    "-> tuple[dict, dict]:": "-> tuple[dict[str, int], dict[str, int]]:",
}
#: Defaults that are no literals in Rust, for arguments that take arrays, too.
DEFAULTS = {"depth_m: numpy.typing.ArrayLike = ...": "depth_m: numpy.typing.ArrayLike = 0.0"}


def mended(text: str) -> str:
    lines = []
    for line in text.rstrip().splitlines():
        if line.lstrip().startswith("def "):
            line = QUOTED.sub(r"\1\2", line)
            for bare, full in {**BARE, **DEFAULTS}.items():
                line = line.replace(bare, full)
        lines.append(line.rstrip())
    # After the module's docstring.
    first = next(i for i, line in enumerate(lines) if line.startswith(("from ", "import ")))
    return HEAD + "\n".join([*lines[:first], IMPORTS + lines[first], *lines[first + 1 :]]) + "\n"


def main() -> None:
    folder, check = Path(sys.argv[1]), "--check" in sys.argv[2:]
    [generated] = folder.rglob("_uwscan.pyi") if not (folder / "_uwscan.pyi").exists() else [folder / "_uwscan.pyi"]
    text = mended(generated.read_text())
    if not check:
        STUBS.write_text(text)
    elif STUBS.read_text() != text:
        sys.exit(f"{STUBS}: not what the Rust sources say; run scripts/python.sh stubs, and look at what changed")


if __name__ == "__main__":
    main()

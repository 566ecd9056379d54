"""Stages what mkdocs.yml builds the site from: pages, the figures that the code makes of itself, and the notebooks, executed.

    python scripts/docs.py [--no-notebooks]

Links that lead out of docs/ become links into the repository; those that lead nowhere are an error, here or of mkdocs --strict.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS, PAGES, PACKAGE = ROOT / "docs", ROOT / "target/docs/pages", ROOT / "target/docs/python"
REPOSITORY = "https://github.com/uwscan/uwscan/blob/main"
LINK = re.compile(r"(?<=\]\()([^)\s#]+)(#[^)\s]*)?(?=\))")
#: Pages, and files beside them, that the site has: by their place in the repository.
SHOWN = {
    "docs/index.md": "index.md",
    "docs/rust.md": "rust.md",
    "docs/paper.md": "paper.md",
    "docs/formats.md": "formats.md",
    "docs/guide/first-ball.md": "guide/first-ball.md",
    "docs/images/overview.png": "images/overview.png",
    **{f"docs/concepts/{name}.md": f"concepts/{name}.md" for name in ("frames", "windows", "sheets", "uncertainty")},
    **{f"docs/api/{name}.md": f"api/{name}.md" for name in ("index", "plot", "others")},
}


def relinked(text: str, source: Path, place: str) -> str:
    """The text with links as they are on the site."""

    def link(found: re.Match[str]) -> str:
        target, anchor = found[1], found[2] or ""
        if ":" in target:
            return found[0]
        path = (source.parent / target).resolve()
        inside = path.relative_to(ROOT).as_posix()
        if inside in SHOWN:
            return os.path.relpath(SHOWN[inside], Path(place).parent) + anchor
        if (PAGES / Path(place).parent / target).exists():
            return found[0]
        if not path.exists():
            raise SystemExit(f"{source.relative_to(ROOT)}: the link to {target} leads nowhere")
        return f"{REPOSITORY}/{inside}{anchor}"

    return LINK.sub(link, text)


def rust() -> str:
    """Where Rust's documentation is, copied along where it was made."""
    made = ROOT / "target/doc"
    if not (made / "uwscan/index.html").is_file():
        print("Rust's documentation was not made (cargo doc --workspace --no-deps): the site says how to")
        return ""
    shutil.copytree(made, PAGES / "rust", ignore=shutil.ignore_patterns(".lock", "src"))
    return "\nIt is [part of this site](rust/uwscan/index.html).\n"


def benchmarks() -> str:
    """How benches are read, and the ratios to what people use instead."""
    parts = [ROOT / "benches/README.md", ROOT / "benches/peers/README.md"]
    texts = [relinked(part.read_text(), part, "benchmarks.md") for part in parts]
    return "\n\n".join(re.sub(r"^#", "##", text, flags=re.M) for text in texts).join(["# Benchmarks\n\n", "\n"])


def notebooks(execute: bool) -> None:
    folder = PAGES / "notebooks"
    folder.mkdir()
    for path in sorted((DOCS / "notebooks").glob("*.ipynb")):
        began = time.monotonic()
        command = [sys.executable, "-m", "nbconvert", "--to", "markdown", "--output-dir", str(folder), str(path)]
        if execute:
            # Paths in notebooks are from their own folder.
            command += ["--execute", "--ExecutePreprocessor.timeout=300"]
        subprocess.run([*command, "--log-level", "WARN"], check=True, env={**os.environ, "MPLBACKEND": "module://matplotlib_inline.backend_inline"})
        page = folder / f"{path.stem}.md"
        page.write_text(page.read_text() + f"\n\n[The notebook]({REPOSITORY}/docs/notebooks/{path.name})\n")
        print(f"{path.relative_to(ROOT)}: {'executed, ' if execute else ''}{time.monotonic() - began:.0f} s", flush=True)


def package() -> None:
    """The package without what is compiled, so that its documentation is read off the stubs."""
    shutil.copytree(ROOT / "python/uwscan", PACKAGE / "uwscan", ignore=shutil.ignore_patterns("*.so", "*.pyd", "__pycache__"))


def main() -> None:
    shutil.rmtree(ROOT / "target/docs", ignore_errors=True)
    PAGES.mkdir(parents=True)
    subprocess.run([sys.executable, str(DOCS / "concepts/figures.py"), str(PAGES / "concepts/figures")], check=True)
    notebooks("--no-notebooks" not in sys.argv[1:])
    package()
    for name, place in SHOWN.items():
        source, target = ROOT / name, PAGES / place
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.suffix == ".md":
            text = source.read_text()
            if "@RUST@" in text:
                text = text.replace("@RUST@", rust())
            target.write_text(relinked(text, source, place))
        else:
            shutil.copyfile(source, target)
    (PAGES / "benchmarks.md").write_text(benchmarks())


if __name__ == "__main__":
    main()

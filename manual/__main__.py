"""`make docs`: builds the site into run/site, whole and without a network, and with --pdf as one file for the ship's folder.

Any warning of mkdocs ends it: a link to a page, a file or a heading that is not there, or a page that docs/README.md does not
list. So does a page that would load anything from elsewhere.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from manual.reference import generated
from manual.staging import staged

ROOT: Final = Path(__file__).parents[1]
HERE: Final = Path(__file__).parent
SCRIPTS: Final = {"mermaid": "dist/mermaid.min.js", "iframe-worker": "shim/index.js"}  # npm package: its file that the site has
LOADED: Final = re.compile(
    r"<(?:script|img|iframe|link)\b[^>]*?\b(?:src|href)=[\"']?((?:https?:)?//[^\"'\s>]+)|url\(\s*[\"']?(https?:[^)]+)"
)
PDF: Final = "delfim.pdf"


def main() -> int:
    asked = argparse.ArgumentParser(prog="make docs", description=(__doc__ or "").partition(":")[2].partition("\n")[0].strip())
    asked.add_argument("--output", type=Path, default=ROOT / "run/site", metavar="DIRECTORY", help="(default: run/site)")
    asked.add_argument(
        "--scripts", type=Path, metavar="DIRECTORY", help="where the packages of manual/scripts.lock lie, as npm packs them"
    )
    asked.add_argument("--pdf", action="store_true", help="print all pages into one file, delfim.pdf, by chromium")
    words = asked.parse_args()
    if words.pdf and shutil.which("chromium") is None:
        asked.error("--pdf needs chromium")
    code = built(ROOT, words.output.resolve(), words.scripts)
    if code == 0 and words.pdf:
        printed(words.output.resolve())
    if code == 0:
        print(f"make docs: {words.output / 'index.html'}" + (f", {words.output / PDF}" if words.pdf else ""))
    return code


def built(root: Path, site: Path, scripts: Path | None) -> int:
    """Builds the site of the documents of a checkout, in a place of its own. Returns 0, or 1 after it has said why not."""
    with tempfile.TemporaryDirectory() as place:
        sources, settings = Path(place, "sources"), Path(place, "mkdocs.yml")
        sources.mkdir()
        nav = staged(root, sources, generated())
        shutil.copy(HERE / "manual.css", sources)
        if scripts is not None:
            _unpack(scripts, sources / "scripts")
        folders = {"docs_dir": str(sources), "site_dir": str(site), "nav": nav}
        told = "".join(f"{name}: {json.dumps(value, ensure_ascii=False)}\n" for name, value in folders.items())
        settings.write_text((HERE / "mkdocs.yml").read_text(encoding="utf-8") + told, encoding="utf-8")
        command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--clean", "--config-file", str(settings)]
        quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}  # an advertisement in front of every build
        if subprocess.run(command, env=quiet).returncode:
            return 1
    for page, address in elsewhere(site):
        print(f"make docs: {page} would load {address}", file=sys.stderr)
        return 1
    return 0


def elsewhere(site: Path) -> Iterator[tuple[str, str]]:
    """(page, address) of everything that a page of the site loads from another host."""
    for path in sorted([*site.rglob("*.html"), *site.rglob("*.css")]):
        for found in LOADED.finditer(path.read_text(encoding="utf-8")):
            yield str(path.relative_to(site)), found[1] or found[2]


def printed(site: Path) -> None:
    """All pages as one PDF, beside them. Raises CalledProcessError where chromium fails."""
    with tempfile.TemporaryDirectory() as profile:
        command = [
            "chromium",
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            f"--user-data-dir={profile}",
            "--no-pdf-header-footer",
        ]
        command += ["--virtual-time-budget=60000", f"--print-to-pdf={site / PDF}", (site / "print_page.html").as_uri()]
        subprocess.run(command, check=True, capture_output=True)


def _unpack(packages: Path, place: Path) -> None:
    place.mkdir()
    for name, path in SCRIPTS.items():
        archive = next(packages.glob(f"{name}-*.tgz"))
        with tarfile.open(archive) as packed, (place / f"{name}.js").open("wb") as out:
            file = packed.extractfile(f"package/{path}")
            assert file is not None, f"{archive} has no {path}"
            shutil.copyfileobj(file, out)


if __name__ == "__main__":
    sys.exit(main())

"""The site's sources: the documents where they stand in the checkout, with the files that they point to, and the list of pages.

The list is that of docs/README.md: a heading is a tab of the site, one below it a group of its pages, a link to a document in a
list below them a page.
"""

import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

LINK: Final = re.compile(r"(?:\]\(|(?:href|src)=\")(?!\w+:)([^)#\s\"]+)")
NAMED: Final = re.compile(r"\[((?:[\w./-]*/)?([\w-]+\.md))\]\(((?:[\w./-]*/)?\2)(#[^)\s]*)?\)")
ENTRY: Final = re.compile(r"\[([^\]]+)\]\(([^)#\s]+\.md)\)")
ITEM: Final = re.compile(r"[*-] |\d+\. ")
NOT_RUN: Final = re.compile(r"^( *)<!-- not run: it (.+) -->\n+((?:\1    .*\n|\n(?=\1    ))+|\1```[^`]*```\n)", re.MULTILINE)
RUN: Final = re.compile(r"^ *<!-- run -->\n\n", re.MULTILINE)
START: Final = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "docs/README.md")


def staged(root: Path, place: Path, generated: Mapping[str, str]) -> list[Any]:
    """Writes the sources into an empty folder, and returns the list of pages as mkdocs takes it (nav). `generated` are pages of
    the reference, text by path. A file that a document points to and that is not there is left out: mkdocs says so."""
    nav = pages((root / "docs/README.md").read_text(encoding="utf-8"), generated)
    titles = dict(titles_of(nav))
    texts = dict(generated)
    for path in sorted(_reached(root)):
        if path.suffix == ".md":
            texts.setdefault(str(path), (root / path).read_text(encoding="utf-8"))
        else:
            (place / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / path, place / path)
    for name, text in texts.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(shown(titled(text, name, titles)), encoding="utf-8")
    return nav


def titled(text: str, name: str, titles: Mapping[str, str]) -> str:
    """A document whose links to other documents, where their text is the name of the file, say the title of the page."""

    def link(found: re.Match[str]) -> str:
        return f"[{titles.get(_path(found[3], name), found[1])}]({found[3]}{found[4] or ''})"

    return NAMED.sub(link, text)


def shown(text: str) -> str:
    """A document as the site shows it: the mark of a block of commands that no test runs becomes a line below that says so."""
    below = r'\n\3\n\1<p class="mark">No test runs this: it \2.</p>\n'
    return RUN.sub("", NOT_RUN.sub(below, "\n".join(_deepened(text.split("\n")))))


def _deepened(lines: Sequence[str]) -> Iterator[str]:
    """Lines that belong to an item of a list, by four columns: Python's Markdown does not take those of the item's mark."""
    more, fenced = 0, False
    for line in lines:
        fenced ^= line.startswith("```")
        if line[:1] not in ("", " "):
            mark = None if fenced else ITEM.match(line)
            more = 4 - len(mark[0]) if mark else 0
        yield " " * more + line if line[:1] == " " else line


def pages(index: str, generated: Mapping[str, str]) -> list[Any]:
    """The list of pages, from the text of docs/README.md; the generated ones stand behind the first of the tab Reference."""
    nav: list[Any] = [{"Delfim": [{"Delfim": "README.md"}, {"All pages": "docs/README.md"}]}]
    for section in re.split(r"^## ", index, flags=re.MULTILINE)[1:]:
        title, _, body = section.partition("\n")
        alone, *groups = re.split(r"^### ", body, flags=re.MULTILINE)
        entries: list[dict[str, Any]] = _listed(alone)
        if title == "Reference":
            found = dict(titles_of(entries))
            entries[1:1] = [
                {text.partition("\n")[0].removeprefix("# "): to} for to, text in generated.items() if to not in found
            ]
        entries += [{name: _listed(below)} for name, _, below in (group.partition("\n") for group in groups)]
        nav.append({title: entries})
    return nav


def _listed(body: str) -> list[dict[str, Any]]:
    """The pages of the lists of a section, each once."""
    listed = "".join(re.findall(r"^\* .*\n(?:  .*\n)*", body, re.MULTILINE))
    found = {_path(to, "docs/README.md"): name[0].upper() + name[1:] for name, to in ENTRY.findall(listed)}
    return [{name: to} for to, name in found.items()]


def titles_of(entries: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """The path of each page, and its title."""
    for title, to in (item for entry in entries for item in entry.items()):
        if isinstance(to, str):
            yield to, title
        else:
            yield from titles_of(to)


def _path(link: str, name: str) -> str:
    """A link of a document, by its path in the checkout."""
    return os.path.normpath(Path(name).parent / link)


def _reached(root: Path) -> Iterator[Path]:
    """The documents, and every file that one of them points to."""
    ahead, seen = (
        [Path(name) for name in START] + [path.relative_to(root) for path in (root / "docs").rglob("*.md")],
        set[Path](),
    )
    while ahead:
        path = ahead.pop()
        if path in seen or path.parts[:1] == ("..",) or not (root / path).is_file():
            continue
        seen.add(path)
        yield path
        if path.suffix == ".md":
            links = LINK.findall((root / path).read_text(encoding="utf-8"))
            ahead += [Path(os.path.normpath(path.parent / link)) for link in links]

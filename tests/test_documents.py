"""The documents' blocks of commands: each is run here, or says on its page why no test runs it; and the site.

A block marked `<!-- run -->` is run, in an empty folder with `etc` and `tests`. One marked `<!-- not run: it needs a boat -->`
is not; but `delfim` in it is parsed, and `make` has its target. A block without a mark fails. An indented block is of commands;
anything else stands in a fence with its language.
"""

import functools
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from delfim.__main__ import parsed
from delfim.commands import SENTENCES
from manual import __main__ as manual
from manual.reference import generated
from manual.staging import pages, shown, titled, titles_of
from tests.services.browser import tab

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", *sorted((ROOT / "docs").rglob("*.md"))]
OWN = re.compile(r"etc/myboat\.toml")  # a reader's file
MARK = re.compile(r" *<!-- (run|not run: it .+) -->")


class Block(NamedTuple):
    at: str  # file:line
    mark: str  # "run", "not run: it needs ...", or none
    lines: list[str]  # the commands; without what they print, where that stands below them


def blocks(path: Path) -> Iterator[Block]:
    """The blocks of commands of a document: indented ones, and fenced ones of sh or of no language."""
    lines, number, mark = path.read_text(encoding="utf-8").splitlines(), 0, ""
    while number < len(lines):
        begin, line = number, lines[number]
        number += 1
        if told := MARK.fullmatch(line):
            mark = told[1]
            continue
        if fence := re.fullmatch(r" *```(\w*)", line):
            while lines[number].strip() != "```":
                number += 1
            number += 1
            body = lines[begin + 1 : number - 1] if fence[1] in ("", "sh") else []
        elif line.startswith("    ") and not lines[begin - 1].strip():
            while number < len(lines) and (lines[number].startswith("    ") or (not lines[number] and _goes_on(lines, number))):
                number += 1
            body = [each.strip() for each in lines[begin:number]]
        else:
            mark = mark if not line.strip() else ""
            continue
        if any(each.startswith("$ ") for each in body):
            body = [each[2:] for each in body if each.startswith("$ ")]
        if body or mark:
            yield Block(f"{path.relative_to(ROOT)}:{begin + 1}", mark, body)
        mark = ""


def _goes_on(lines: list[str], number: int) -> bool:
    return number + 1 < len(lines) and lines[number + 1].startswith("    ")


BLOCKS = [block for path in DOCUMENTS for block in blocks(path)]


def commands(block: Block) -> list[list[str]]:
    """The words of each command."""
    text = "\n".join(block.lines).replace("\\\n", " ")
    return [words for line in text.splitlines() if (words := shlex.split(line, comments=True))]


def complaint(words: list[str]) -> str:
    """Why this cannot be a command of this checkout; empty: it can. `delfim` is parsed, not run."""
    words = words[1:] if words[0] == "sudo" else words
    absent = [each for each in words if re.fullmatch(r"(etc|tests)/[\w./-]+", each.partition(":")[0])]
    absent = [each for each in absent if not (ROOT / each.partition(":")[0]).exists() and not OWN.fullmatch(each)]
    if absent:
        return f"there is no {', '.join(absent)}"
    program, rest = Path(words[0]).name, words[1:]
    if program == "delfim" and rest:
        try:
            parsed(rest)
        except (Exception, SystemExit) as error:
            return f"{' '.join(words)}: {error}"
    elif program == "make" and "-C" not in rest:
        absent = [each for each in rest if "=" not in each and each not in targets()]
        return f"make has no {', '.join(absent)}" if absent else ""
    elif program == "python" and rest[:1] == ["-m"]:
        path = ROOT / rest[1].replace(".", "/")
        return "" if path.with_suffix(".py").exists() or path.is_dir() else f"there is no module {rest[1]}"
    return ""


@functools.cache
def targets() -> set[str]:
    return set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.at)
def test_a_block_has_a_mark_and_can_be_typed(block: Block) -> None:
    assert block.mark, "a mark is missing: run, or not run and why; what is no command stands in a fence with its language"
    assert block.lines, "this mark stands before no command"
    if block.mark != "run":
        assert [told for words in commands(block) if (told := complaint(words))] == []


RUN = [path for path in DOCUMENTS if any(block.mark == "run" for block in blocks(path))]


@pytest.mark.long
@pytest.mark.timeout(1200)  # a chart's cell takes minutes of processor
@pytest.mark.parametrize("path", RUN, ids=lambda path: path.name)
def test_what_is_marked_runs(path: Path, tmp_path: Path) -> None:
    """All marked blocks of a document, one after the other, as a reader types them."""
    for name, place in (("etc", ROOT / "etc"), ("tests", ROOT / "tests"), (".venv", sys.prefix)):
        (tmp_path / name).symlink_to(place)
    there = os.environ | {"PATH": f"{sys.prefix}/bin:{os.environ['PATH']}", "MPLCONFIGDIR": str(tmp_path)}
    for block in (each for each in blocks(path) if each.mark == "run"):
        text = "\n".join(block.lines)
        end = subprocess.run(
            ["sh", "-ec", text], cwd=tmp_path, env=there, stdin=subprocess.DEVNULL, capture_output=True, text=True
        )
        assert end.returncode == 0, f"{block.at}: {end.stdout[-2000:]}{end.stderr[-2000:]}"


def test_of_each_kind_of_block_there_are_some() -> None:
    """So that a change of the documents' form does not leave these tests without anything to look at."""
    kinds = [each.mark.partition(":")[0] for each in BLOCKS]
    assert min(kinds.count(kind) for kind in ("run", "not run")) >= 10, kinds


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("delfim sim etc/delfimx.toml --lockstep", ""),
        ("delfim sim etc/delfimx.toml --lockstepp", "2"),
        ("delfim sim etc/no-boat.toml", "there is no etc/no-boat.toml"),
        ("make tast", "make has no tast"),
        ("~/delfim/bin/delfim simm", "there is no command"),
        ("candump can0", ""),
        ("python -m tests.vehicle.no_such", "no module"),
    ],
)
def test_a_command_that_does_not_exist_is_found(line: str, why: str, capsys: pytest.CaptureFixture[str]) -> None:
    told = complaint(shlex.split(line))
    assert why in told
    assert bool(told) == bool(why)


def test_the_site_has_a_tab_for_each_kind_of_page_and_every_document_in_one() -> None:
    nav = pages((ROOT / "docs/README.md").read_text(), {"docs/metrics.md": "# Metrics\n"})
    assert [title for tab in nav for title in tab] == ["Delfim", "Tutorials", "How-to", "Reference", "Explanation"]
    listed = [to for to, _ in titles_of(nav[1:])]
    assert len(listed) == len(set(listed))
    documents = {str(path.relative_to(ROOT)) for path in DOCUMENTS} - {"README.md", "docs/README.md"}
    assert documents | {"docs/metrics.md", "CHANGELOG.md", "etc/encounters/README.md"} == set(listed)
    groups = {name: len(below) for group in nav[2]["How-to"] for name, below in group.items()}
    assert list(groups)[:3] == ["Your boat", "At sea", "Parts of your own"]
    assert max(groups.values()) <= 6, "a list that one can look over"


def test_a_link_says_the_title_of_its_page_where_it_only_had_the_name_of_a_file() -> None:
    titles = {"docs/sea.md": "From the box to the water"}
    text = "[sea.md](sea.md#keys), [keys](sea.md), [docs/sea.md](docs/sea.md)"
    assert titled(text, "docs/shore.md", titles).startswith("[From the box to the water](sea.md#keys), [keys](sea.md), [docs/")
    assert titled(text, "README.md", titles).endswith("[From the box to the water](docs/sea.md)")


def test_a_page_says_which_commands_no_test_runs() -> None:
    block = "<!-- not run: it needs a boat -->\n\n    ssh boat\n\n<!-- run -->\n\n    delfim\n"
    told = shown(f"Say:\n\n{block}\n1. First:\n\n       ip link\n")
    assert '\n    ssh boat\n\n<p class="mark">No test runs this: it needs a boat.</p>\n\n    delfim\n' in told
    assert told.endswith("1. First:\n\n        ip link\n")


def test_the_reference_has_every_command_parameter_message_and_metric() -> None:
    made = generated()
    assert [name for name in SENTENCES if f"### `delfim {name}`" not in made["docs/commands.md"]] == []
    assert "--lockstep" in made["docs/commands.md"]
    assert "#### `delfim log export`" in made["docs/commands.md"]
    assert "| `HEAD_P` | `control.heading.p_nm_per_rad` | N m per rad |" in made["docs/mavlink-tables.md"]
    assert "| 33 | `GLOBAL_POSITION_INT` | – | 1 | 0.1 | yes |" in made["docs/mavlink-tables.md"]
    assert "| `kill` |  |  | idle |  |" in made["docs/websocket.md"]
    assert (
        "| `Run` | 16 | u1 | 1 | 0 motor off, 1 run | Motor off whatever the reference says, or run. |"
        in made["docs/can-messages.md"]
    )
    assert "| `latitude_rad` | 8 | i32 | 1e-07 degrees | 0x7fffffff |  |" in made["docs/can-messages.md"]
    assert "| `hdop` | 4 | u8 | 0.1 | 0xff |  |" in made["docs/can-messages.md"]
    source = (ROOT / "delfim/services/page/metrics.py").read_text()
    named = set(re.findall(r'"(delfim_[a-z_]+)"', source))
    assert [name for name in named if f"| `{name}` |" not in made["docs/metrics.md"]] == []


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, as `make docs` makes it."""
    site = tmp_path_factory.mktemp("manual") / "site"
    assert manual.built(ROOT, site, Path(sys.prefix, "scripts")) == 0
    return site


@pytest.mark.long
def test_the_site_loads_nothing_from_elsewhere(site: Path, tmp_path: Path) -> None:
    assert (site / "docs/first-voyage.html").exists()
    assert list(manual.elsewhere(site)) == []
    spy = '<script src="https://spy.example/x.js"></script><link rel="icon" href=//spy.example/i.png>'
    (tmp_path / "spy.html").write_text(spy)
    assert [address for _, address in manual.elsewhere(tmp_path)] == ["https://spy.example/x.js", "//spy.example/i.png"]


@pytest.mark.long
async def test_a_reader_without_a_network_finds_and_sees_everything(site: Path) -> None:
    """From a folder, not from a server: the search of a browser that reaches nobody, and the diagrams."""
    async with tab() as page:
        await page.call("Network.enable")
        await page.open(f"{site.as_uri()}/docs/sea.html?q=%22dead-man%22", width=1280, height=900)
        await page.until("!!document.querySelector('.md-search-result__item a')")
        found = await page.value("[...document.querySelectorAll('.md-search-result__item > a')].map(a => a.pathname)")
        assert any(path.endswith("/docs/runtime.html") for path in found)
        await page.open(f"{site.as_uri()}/docs/runtime.html", width=1280, height=900)
        await page.until("!!document.querySelector('div.mermaid')")  # pre, until it is drawn
        assert [url for url in page.requests if not url.startswith(("file:", "blob:", "data:"))] == []
        await page.open(f"{site.as_uri()}/docs/vehicle-file.html", width=390, height=844)
        widths = await page.value("[...document.querySelectorAll('.md-typeset table')].map(each => each.scrollWidth)")
        assert sum(width > 370 for width in widths) <= 0.2 * len(widths), "a phone shows all columns of a table"


@pytest.mark.long
def test_the_ships_folder_has_all_pages_in_one_file(site: Path) -> None:
    manual.printed(site)
    paper = (site / manual.PDF).read_bytes()
    assert paper.startswith(b"%PDF-")
    assert paper.count(b"/Type /Page\n") > len(DOCUMENTS)


@pytest.mark.long
def test_a_dead_link_ends_the_build(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    checkout = tmp_path / "checkout"
    shutil.copytree(ROOT / "docs", checkout / "docs")
    for name in ("etc", "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "LICENSE"):
        (checkout / name).symlink_to(ROOT / name)
    links = ["no-such-page.md", "clock.md#no-such-heading", "../etc/no-such-boat.toml", "pictures/none.png"]
    with (checkout / "docs/timed.md").open("a") as page:
        page.writelines(f"\n[nowhere]({link})\n" for link in links)
    assert manual.built(checkout, tmp_path / "site", None) == 1
    warned = [line for line in capfd.readouterr().err.splitlines() if "timed.md" in line]
    assert [link for link in links if not any(link in line for line in warned)] == []

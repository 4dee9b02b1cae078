"""Evidence of a voyage: one folder, or zip, with its logs as they are, who commanded when, and whether anything was changed.

index.html      to look at: the boat, who commanded from when to when, events, the check of the chains
commands.csv    each command, change of mode and trouble: time, who, what, result
check.txt       what `delfim log check logs` says
logs/           the files themselves, with sidecars and chains, byte by byte
track.png       where the boat was, if matplotlib is here
SHA256SUMS      of all of them
"""

import csv
import hashlib
import os
import shutil
import tempfile
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, NamedTuple

from delfim.base.errors import DelfimError
from delfim.desk import htmlpage
from delfim.logging import chain
from delfim.logging.ashore import chaincheck, tree
from delfim.logging.ashore.eventtable import HEADS, rows
from delfim.logging.ashore.summary import utc
from delfim.logging.ashore.tree import LogFile, Span

LAST_S: Final = 12 * 3600  # of a voyage, unless another span is asked for
SHOWN: Final = 2000  # events on the page; the table has all
META: Final = ".meta.jsonl"


class HeldBy(NamedTuple):
    """Somebody who commanded, from his first order that was obeyed to that of the next."""

    who: str
    from_ns: int
    to_ns: int
    obeyed: int
    refused: int


def evidence(paths: Sequence[str], span: Span | None, output: Path, now_ns: int) -> list[chaincheck.ChainVerdict]:
    """Write the evidence of a span, None: the last twelve hours that were logged, and return the verdicts on its files. Raises
    DelfimError where there is none, or something is at `output`."""
    if output.exists():
        raise DelfimError(f"{output} is there already: evidence is not mixed with anything")
    files = [file for file in tree.files(paths) if "-repaired." not in file.path]
    if not files:
        raise DelfimError(f"no logs in {', '.join(paths)}")
    runs = tree.runs(files, now_ns)
    last_ns = max(run.end_ns for run in runs)
    its = span or Span(last_ns - LAST_S * 1_000_000_000, last_ns)
    chosen = tree.within(runs, its)
    if not chosen:
        raise DelfimError(f"nothing was logged from {utc(its.from_ns)} to {utc(its.to_ns)} UTC")
    folder = output if output.suffix != ".zip" else Path(tempfile.mkdtemp(dir=output.parent, prefix=output.name))
    try:
        verdicts = _written(chosen, its, folder, now_ns)
        if folder != output:
            _pack(folder, output)
    finally:
        if folder != output:
            shutil.rmtree(folder)
    return verdicts


def watches(events: Iterable[Mapping[str, Any]], end_ns: int) -> list[HeldBy]:
    """Who commanded when, oldest first. An order that was refused gives nobody the boat."""
    found = list[HeldBy]()
    for event in sorted(events, key=lambda each: each["t_ns"]):
        if event["event"] != "command":
            continue
        who, t_ns, refused = tree.readable(str(event.get("operator") or "?")), event["t_ns"], bool(event["refused"])
        if found and found[-1].who == who:
            last = found.pop()
            found.append(last._replace(to_ns=t_ns, obeyed=last.obeyed + (not refused), refused=last.refused + refused))
        elif not refused:
            found += [found.pop()._replace(to_ns=t_ns)] if found else []
            found.append(HeldBy(who, t_ns, t_ns, 1, 0))
    return [*found[:-1], found[-1]._replace(to_ns=max(end_ns, found[-1].to_ns))] if found else []


def _written(chosen: Sequence[LogFile], span: Span, folder: Path, now_ns: int) -> list[chaincheck.ChainVerdict]:
    for file in chosen:
        _copy(file, folder / "logs")
    verdicts = chaincheck.check([str(folder / "logs")], now_ns)
    verdicts = [each._replace(path=os.path.relpath(each.path, folder)) for each in verdicts]
    told = sorted(tree.events(chosen, span), key=lambda each: each["t_ns"])
    listed = list(rows(told))
    with open(folder / "commands.csv", "w", encoding="utf-8", newline="") as table:
        csv.writer(table).writerows([HEADS, *listed])
    (folder / "check.txt").write_text("\n".join(chaincheck.text(verdicts)) + "\n", encoding="utf-8")
    has_track = _track(chosen, span, folder / "track.png")
    page = _page(chosen, span, told, listed, verdicts, has_track=has_track)
    (folder / "index.html").write_text(page, encoding="utf-8")
    inside = sorted(path for path in folder.rglob("*") if path.is_file())
    sums = [f"{_digest(path)}  {path.relative_to(folder).as_posix()}\n" for path in inside]
    (folder / "SHA256SUMS").write_text("".join(sums), encoding="utf-8")
    return verdicts


def _copy(file: LogFile, place: Path) -> None:
    """Copy a log with its chain and sidecar, the chain first: what it tells of is then there, though the boat still writes."""
    source = Path(file.path)
    stem = source.name.partition(".")[0]
    target = place / source.parent.parent.name / source.parent.name
    target.mkdir(parents=True, exist_ok=True)
    for name in (stem + chain.SUFFIX, source.name, stem + META):
        if (source.parent / name).exists():
            shutil.copy2(source.parent / name, target / name)


def _page(
    chosen: Sequence[LogFile],
    span: Span,
    events: Sequence[Mapping[str, Any]],
    listed: Sequence[Sequence[str]],
    verdicts: Sequence[chaincheck.ChainVerdict],
    *,
    has_track: bool,
) -> str:
    starts = [event for event in events if event["event"] == "start" and isinstance(event.get("settings"), dict)]
    boat = next((str(event["settings"].get("boat", {}).get("name", "")) for event in starts), "") or "a boat"
    versions = ", ".join(dict.fromkeys(str(event.get("version", "?")) for event in starts)) or "not told in this time"
    bad = [each for each in verdicts if each.found in chaincheck.BAD]
    from_ns, to_ns = max(span.from_ns, min(f.begin_ns for f in chosen)), min(span.to_ns, max(f.end_ns for f in chosen))
    title = f"{boat}: evidence from {utc(from_ns)} to {utc(to_ns)} UTC"
    words = f"{len(bad)} of {len(verdicts)} files are not as they were written" if bad else "no file was changed"
    body = [
        f"<h1>{escape(title)}</h1>",
        f"<p>Delfim {escape(versions)}; {len(verdicts)} logs, as they are, in <code>logs</code>.",
    ]
    body.append(f"<p class={'fails' if bad else 'holds'}>By the chains: {escape(words)}.</p>")
    held = [
        (each.who, utc(each.from_ns), utc(each.to_ns), str(each.obeyed), str(each.refused)) for each in watches(events, to_ns)
    ]
    body.append("<h2>Who commanded when</h2>")
    body.append(htmlpage.table(("who", "from (UTC)", "until", "orders obeyed", "refused"), held) if held else "<p>Nobody.</p>")
    soft = "It is the name by which the boat knew the sender of an order; no log knows who sat there. A hand-set is a mode."
    body.append(f"<p class=soft>{soft}</p>")
    body += ["<h2>Where</h2><img alt='track of the boat' src=track.png>"] if has_track else []
    body.append("<h2>Commands, modes, troubles</h2>")
    body += [f"<p>The first {SHOWN} of {len(listed)}; all are in commands.csv.</p>"] if len(listed) > SHOWN else []
    body.append(htmlpage.table(HEADS, listed[:SHOWN]))
    body.append("<h2>The check of each file</h2>")
    heads = [(id_, head) for id_, head in chaincheck.heads(verdicts).items()]
    body.append(htmlpage.table(("file", "found", "why"), [(each.path, each.found, each.words) for each in verdicts]))
    body.append("<h2>Heads of the chains</h2>")
    body.append(htmlpage.table(("log", "head"), heads))
    body.append(
        "<p class=soft>Note the heads where nobody aboard can write; <code>delfim log check logs --head HEAD</code>.</p>"
    )
    return htmlpage.whole(title, body)


def _track(chosen: Sequence[LogFile], span: Span, file: Path) -> bool:
    """Draw where the boat was; returns whether there is a picture."""
    if find_spec("matplotlib") is None:
        return False
    from delfim.logging.ashore import plot
    from delfim.logging.ashore.table import table

    states = [each for each in chosen if each.suffix.startswith(".state")]
    try:
        columns, schema = table(states, span)
    except DelfimError:
        return False
    plot.track(columns, [], schema.boat, file)
    return True


def _pack(folder: Path, output: Path) -> None:
    part = output.with_name(output.name + ".part")
    with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, strict_timestamps=False) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, f"{output.stem}/{path.relative_to(folder).as_posix()}")
    os.replace(part, output)


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

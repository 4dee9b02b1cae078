"""Checks logs by their chains (delfim.logging.chain): what was changed since it was written, and what the power cut short.

A file that was cut lacks its end and the last link, and what follows the last link that is there, some seconds, is held by
nothing. A file that was changed, shortened or removed differs from a link.
"""

import hashlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from delfim.base.errors import DelfimError, FormatError
from delfim.base.input.untrusted import parse_json
from delfim.logging.ashore import tree
from delfim.logging.ashore.repair import pieces
from delfim.logging.ashore.summary import utc
from delfim.logging.chain import SUFFIX, link_of
from delfim.logging.liblog import in_order
from delfim.logging.reading import raw

META: Final = ".meta.jsonl"
BEHIND: Final = 2  # gzip members that may be whole behind the last link: a link follows each, unless the disk took none
SIZE_MAX: Final = 1 << 40
HEAD_MIN: Final = 8  # digits of a head by which it is looked for
Found = Literal["whole", "cut", "running", "changed", "gone", "no chain"]
BAD: Final[tuple[Found, ...]] = ("changed", "gone", "no chain")


class ChainVerdict(NamedTuple):
    """What became of one file of a log, and why in words."""

    path: str
    id: str
    found: Found
    words: str
    before: str | None = None  # the link that its chain begins with; None: unknown
    links: tuple[str, ...] = ()


def check(paths: Sequence[str], now_ns: int) -> list[ChainVerdict]:
    """Check all logs in these paths. Raises OSError, DelfimError where there is none."""
    paths = [os.path.abspath(path) for path in paths]  # as the tree names its files: one name for a log and for its chain
    files = {_stem(file.path): file.path for file in tree.files(paths) if "-repaired." not in file.path}
    folders = {Path(stem).parent for stem in files} | {Path(path) for path in paths if os.path.isdir(path)}
    chains = {str(file).removesuffix(SUFFIX): file for folder in folders for file in folder.rglob(f"*{SUFFIX}")}
    named = {Path(path) for path in paths if os.path.isfile(path)}
    found = []
    for stem in in_order([Path(stem) for stem in {*files, *chains}]):
        if named and not any(_stem(str(each)) == str(stem) for each in named):
            continue
        path = files.get(str(stem), "")
        id_ = tree.readable(stem.parent.name)
        if (chain := chains.get(str(stem))) is None:
            found.append(ChainVerdict(path, id_, "no chain", "no chain is beside it"))
        else:
            found.append(_checked(chain, path, id_, now_ns))
    if not found:
        raise DelfimError(f"no logs in {', '.join(paths)}")
    return found if named else list(_followed(found))


def heads(verdicts: Sequence[ChainVerdict]) -> dict[str, str]:
    """The newest link of each log, by its id: kept elsewhere it shows a chain that was made anew."""
    return {each.id: each.links[-1] for each in verdicts if each.links}


def knows(verdicts: Sequence[ChainVerdict], head: str) -> bool:
    """Whether a head that was noted earlier, or its beginning, is among the links."""
    return len(head) >= HEAD_MIN and any(link.startswith(head) for each in verdicts for link in each.links)


def text(verdicts: Sequence[ChainVerdict]) -> Iterator[str]:
    """The verdicts as lines for people."""
    words: tuple[Found, ...] = ("whole", "cut", "running", *BAD)
    wide = max(len(each.id) for each in verdicts) + 2
    yield f"{'ID':{wide}}{'FILES':>6}" + "".join(f"{word.upper():>10}" for word in words) + "  HEAD"
    newest = heads(verdicts)
    for id_ in dict.fromkeys(each.id for each in verdicts):
        its = [each.found for each in verdicts if each.id == id_]
        counts = "".join(f"{its.count(word):10}" for word in words)
        yield f"{id_:{wide}}{len(its):6}{counts}  {newest.get(id_, '')[:16]}"
    for each in verdicts:
        if each.found not in ("whole", "running"):
            yield f"{each.found.upper()} {each.path}: {each.words}"


def _stem(path: str) -> str:
    folder, name = os.path.split(path)
    return os.path.join(folder, name.partition(".")[0])


def _followed(found: Sequence[ChainVerdict]) -> Iterator[ChainVerdict]:
    """The verdicts, with those whose chain does not go on from a link that is here."""
    known = {(each.id, link) for each in found for link in each.links}
    begun = set[str]()
    for each in found:
        is_lost = each.before is not None and each.id in begun and (each.id, each.before) not in known
        if each.links:
            begun.add(each.id)
        if is_lost and each.found in ("whole", "cut", "running"):
            words = "what was logged before it is not here: removed by somebody, or for room between days that are kept"
            yield each._replace(found="gone", words=words if each.before else "it begins a chain anew behind older files")
        else:
            yield each


def _checked(chain: Path, path: str, id_: str, now_ns: int) -> ChainVerdict:
    """The verdict on a log and its sidecar by their chain alone."""
    before, lines = _read(chain)
    log, meta = (raw(each) if os.path.exists(each) else b"" for each in (path or "/nowhere", str(chain.with_suffix(META))))
    shown, last, links = path or str(chain), before or "", list[str]()
    if before is None:
        lines = []
    digests, at, end, when_ns = (hashlib.sha256(), hashlib.sha256()), (0, 0), False, 0
    for line in lines:
        sizes = line["log"], line["meta"]
        since = f"between {utc(when_ns) if when_ns else 'its beginning'} and {utc(line['t_ns'])} UTC"
        trouble = _short(sizes, (len(log), len(meta)), at, line["t_ns"]) or (f"changed {since}, behind its end" if end else "")
        for digest, data, begin, size in zip(digests, (log, meta), at, sizes, strict=True):
            digest.update(memoryview(data)[begin:size])
        end = bool(line.get("end"))
        its = link_of(last, line["t_ns"], sizes, (digests[0].digest(), digests[1].digest()), end=end)
        if trouble or its != line["link"]:
            return ChainVerdict(shown, id_, "changed", trouble or f"changed {since}", before, tuple(links))
        links.append(its)
        last, at, when_ns = its, sizes, line["t_ns"]
    found, words = _tail(log, at, (len(log), len(meta)), end=end, is_new=_is_new(chain, path, now_ns))
    return ChainVerdict(shown, id_, found, words, before, tuple(links))


def _short(sizes: tuple[int, int], there: tuple[int, int], at: tuple[int, int], t_ns: int) -> str:
    """Why files of these sizes cannot be those of a link."""
    for name, size, its, was in zip(("the log", "the sidecar"), sizes, there, at, strict=True):
        if size > its:
            return f"{name} has {its} bytes; it had {size} at {utc(t_ns)} UTC"
        if size < was:
            return f"{name} is said to have grown shorter at {utc(t_ns)} UTC"
    return ""


def _tail(log: bytes, at: tuple[int, int], there: tuple[int, int], *, end: bool, is_new: bool) -> tuple[Found, str]:
    """The verdict by what follows the last link."""
    more = there[0] - at[0], there[1] - at[1]
    if end:
        told = f"{more[0]} bytes of the log and {more[1]} of the sidecar are more than when it ended"
        return ("changed", told) if any(more) else ("whole", "")
    reached = whole = 0
    for piece in pieces(log) if more[0] else ():
        reached += len(piece.raw)
        whole += reached > at[0] and not piece.trouble
    if whole > BEHIND:
        return "changed", f"{more[0]} bytes were added behind the last link"
    if is_new:
        return "running", ""
    return (
        "cut",
        f"it was not ended; {more[0]} bytes of the log and {more[1]} of the sidecar behind the last link are held by nothing",
    )


def _is_new(chain: Path, path: str, now_ns: int) -> bool:
    times = [os.stat(each).st_mtime_ns for each in (chain, path) if each and os.path.exists(each)]
    return any(abs(now_ns - each) < tree.RUNNING_S * 1_000_000_000 for each in times)


def _read(chain: Path) -> tuple[str | None, list[dict[str, Any]]]:
    """The link that a chain begins with, None if that is not told, and its links; torn lines are left out."""
    before, links = None, []
    for line in raw(chain).splitlines():
        try:
            told = parse_json(line)
        except FormatError:
            continue
        if not isinstance(told, dict) or not _is_count(told.get("t_ns"), 1 << 63):
            continue
        if before is None and isinstance(told.get("before"), str):
            before = told["before"]
        elif isinstance(told.get("link"), str) and all(_is_count(told.get(key), SIZE_MAX) for key in ("log", "meta")):
            links.append(told)
    return before, links


def _is_count(value: object, below: int) -> bool:
    return type(value) is int and 0 <= value < below

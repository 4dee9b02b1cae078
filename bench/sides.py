"""`make bench ARGS=disk`, `watchers`, `datagrams`, `floods`, `downloads`: does the critical path feel what happens beside it?

This program alone, at 100 Hz on a full bus, in slices that take turns: with a healthy log partition and with each way in which
one fails; without clients of cantcpd and with eight that watch the bus, one of them asleep; with nobody on the consoles' link
and with 3,500 fuzzed datagrams a second; with doors that somebody floods; without downloads and while somebody fetches a log
by FTP or SFTP. The undisturbed
case has two turns a round, and how far it is from itself is the noise. Latency is that which the bus sees
(bench.onlooker), because the state log is what is tried. What is measured, and how to read it: docs/benchmark.md.
"""

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from bench import report
from bench.critical_path import Slice, Team, build, running
from bench.disk import Disk, leave_mounts
from bench.downloads import Downloads
from bench.floods import KINDS, PAYLOAD, payload, sensor_line
from bench.load import ASHORE, prepare
from bench.onlooker import Onlooker
from bench.stalled import Radio
from delfim.base.errors import DelfimError
from delfim.base.input.keys import new_key
from delfim.vehicle.operator.link import Link

RATE_HZ: Final = 100.0
WATCHERS: Final = 8
LIMITS: Final = dict.fromkeys(report.PERCENTILES, 1.2)  # of the ratio to the undisturbed case; p99 is the contract
SECONDS, QUICK_SECONDS = 12.0, 2.0
MARGIN: Final = 1 / 12  # of a slice, before the trouble and after it: of 12 s it lasts 10
KILL_EVERY_S: Final = 1.0
LOOK_S: Final = 0.25  # between two looks at how the log fares
SETTLE_S: Final = 2.0  # what a dead writer took along is known by then
ANSWER_S: Final = 20.0  # a machine with a lot to do answers late, and is asked all the same
MEND_S: Final = 15.0  # a log that is not written again by then does not come back
RADIO: Final = "a serial radio that stalls"
SETTINGS: Final = ("log.free_bytes_min=0",)  # a full disk is met, not avoided

Trouble = Callable[[], object]


class Turn(NamedTuple):
    """One slice of one case."""

    paths_us: list[float]
    due: int
    dropped: int  # records of the state log, all of them counted by the program itself
    mended_s: float  # from the end of the trouble until the log is written again
    reason: str  # why the log could not be written, in its own words
    slice: Slice
    state: dict[str, Any]  # what the vehicle said of itself


def run_disk(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when everything was measured. Raises DelfimError where it may not mount."""
    leave_mounts()
    seconds, rounds = _length(asked)
    turns = defaultdict[str, list[Turn]](list)
    with contextlib.ExitStack() as links:
        place = Path(links.enter_context(tempfile.TemporaryDirectory(prefix="delfim-bench-")))
        disk = links.enter_context(Disk(place / "delfim" / "log"))
        team = links.enter_context(_team(asked, place))
        look = links.enter_context(Onlooker(team.interface))
        clients = None if asked.quick else links.enter_context(_clients())
        killer = _Killer(team)
        troubles: dict[str, tuple[Trouble, Trouble]] = {
            "writers killed": (killer.start, killer.stop),
            "disk full (ENOSPC)": (disk.fill, disk.mend),
            "disk hangs": (disk.freeze, disk.mend),
            "mounted read-only (EROFS)": (disk.abort, lambda: _renew(disk, place)),
            "disk torn out (EIO)": (disk.fail, lambda: _renew(disk, place)),
        }
        for number in range(rounds):
            order = list(troubles)
            for name in ("", *(order if number % 2 else reversed(order)), ""):
                _say(f"{name or 'healthy'}, round {number + 1} of {rounds}")
                turns[name].append(_troubled(team, look, clients, seconds, *troubles.get(name, (_nothing, _nothing))))
    rows = _rows(turns, "a healthy disk")
    _write(asked, "disk", rows)
    print(_table(rows, ("records dropped", "back after s"), lambda row: (row["dropped"], f"{row['mended_s']:.1f}")))
    for row in rows[1:]:
        print(f"  {row['case']}: {row['reason'] or 'the log was written all the time'}")
    return 0


def run_watchers(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when everything was measured, 1 where a client that is awake lost frames."""
    seconds, rounds = _length(asked)
    turns = defaultdict[str, list[Turn]](list)
    with _afloat(asked) as (_, team, look), _clients() as clients:
        for number in range(rounds):
            for watchers in (0, WATCHERS, 0):
                _say(f"{watchers} clients, round {number + 1} of {rounds}")
                its = clients if watchers else None
                turns["8 clients, one asleep" if watchers else ""].append(_turn(team, look, its, seconds, watchers=watchers))
    rows = _rows(turns, "no client")
    figures = _watched(turns["8 clients, one asleep"], rows, asked.frames)
    _write(asked, "watchers", rows, **figures)
    print(_table(rows, ("of a core",), lambda row: (f"{row['cpu_share']:.1%}",)))
    print(
        f"  a client costs {figures['core_share_per_client']:.2%} of a core, {figures['cpu_ms_per_1000_frames']:.3f} ms for"
        f" 1,000 frames; frames lost by clients awake: {figures['lost_awake']}, by the one asleep: {figures['lost_asleep']}"
    )
    return int(figures["lost_awake"] > 0)


def run_downloads(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when everything was measured. Raises DelfimError where a client is missing."""
    seconds, rounds = _length(asked)
    turns = defaultdict[str, list[Turn]](list)
    rates = defaultdict[str, list[float]](list)
    with (
        _afloat(asked) as (place, team, look),
        Downloads(asked.set, asked.file, place / "delfim" / "log", place) as downloads,
    ):
        for number in range(rounds):
            for how in ("", *(("FTP", "SFTP") if number % 2 else ("SFTP", "FTP")), ""):
                _say(f"{how or 'no'} download, round {number + 1} of {rounds}")
                began_s = time.monotonic()
                with downloads.fetching(how) if how else contextlib.nullcontext([0]) as fetched:
                    turns[f"download by {how}" if how else ""].append(_turn(team, look, None, seconds))
                    took_s = time.monotonic() - began_s
                rates[how].append(fetched[0] / took_s / 1e6)
    rows = _rows(turns, "no download")
    for row in rows:
        its = rates[row["case"].removeprefix("download by ") if row["case"] != "no download" else ""]
        row["megabytes_per_s"] = round(sum(its) / len(its), 1)
    _write(asked, "downloads", rows)
    print(_table(rows, ("MB/s",), lambda row: (f"{row['megabytes_per_s']:.1f}",)))
    return 0


def run_datagrams(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when everything was measured, 1 where the datagrams moved the boat."""
    seconds, rounds = _length(asked)
    turns = defaultdict[str, list[Turn]](list)
    with _afloat(asked) as (_, team, look), _clients("bench.fuzz") as sender:
        for number in range(rounds):
            for its in (None, sender, None):
                _say(f"{'fuzzed' if its else 'no'} datagrams, round {number + 1} of {rounds}")
                turns["fuzzed datagrams" if its else ""].append(_turn(team, look, its, seconds))
    rows = _rows(turns, "no datagrams")
    sent = sum(turn.slice.served["datagrams"] for turn in turns["fuzzed datagrams"])
    mode, reason = team.state["mode"], team.state["reason"]
    counts: dict[str, int] = team.state["mavlink"]["counts"]
    _write(asked, "datagrams", rows, datagrams=sent, counts=counts, mode=mode)
    print(_table(rows, ("of a core",), lambda row: (f"{row['cpu_share']:.1%}",)))
    words = ", ".join(f"{name} {count}" for name, count in counts.items())
    print(f"  {sent} datagrams; frames refused: {words}; the boat's mode after them: {mode} ({reason})")
    return int(mode != "heading")


def run_floods(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when everything was measured, 1 where a flood moved the boat."""
    seconds, rounds = _length(asked)
    turns = defaultdict[str, list[Turn]](list)
    sent: Counter[str] = Counter()
    with contextlib.ExitStack() as links:
        key = Path(links.enter_context(tempfile.TemporaryDirectory(prefix="delfim-bench-"))) / "key"
        new_key(key)  # or there would be nothing to forge
        radio = links.enter_context(Radio(key))
        keys = f'mavlink.key="{key}"', f'mavlink.serial="{radio.port}"'
        line = 'sensors.names=["sysstat", "nmea0183"]', f'nmea0183.ports.broken.device="{sensor_line(os.getpid())}"'
        asked = argparse.Namespace(**vars(asked) | {"set": [*asked.set, *keys, *line]})
        place, team, look = links.enter_context(_afloat(asked))
        doors = links.enter_context(Downloads(asked.set, asked.file, place / "delfim" / "log", place))
        senders = {kind: links.enter_context(_clients("bench.floods", kind, str(doors.ports["ftpd"]))) for kind in KINDS}
        for number in range(rounds):
            order = list(KINDS)
            for kind in ("", *(order if number % 2 else reversed(order)), PAYLOAD, RADIO, ""):
                _say(f"{kind or 'no flood'}, round {number + 1} of {rounds}")
                beside = {PAYLOAD: lambda: payload(asked.set, asked.file, place), RADIO: radio.stalled}
                with beside.get(kind, contextlib.nullcontext)() as counted:
                    turns[kind].append(_turn(team, look, senders.get(kind), seconds))
                sent[kind] += turns[kind][-1].slice.served.get("sent", 0) + sum(counted or ())
        mode, reason = team.state["mode"], team.state["reason"]
    rows = [row | {"sent": sent[row["case"]]} for row in _rows(turns, "no flood")]
    _write(asked, "floods", rows, mode=mode)
    print(_table(rows, ("sent", "of a core"), lambda row: (row["sent"], f"{row['cpu_share']:.1%}")))
    print(f"  the boat's mode after them: {mode} ({reason})")
    return int(mode != "heading")


def _length(asked: argparse.Namespace) -> tuple[float, int]:
    """Seconds of a slice, and rounds."""
    return asked.seconds or (QUICK_SECONDS if asked.quick else SECONDS), asked.rounds or (1 if asked.quick else 3)


@contextlib.contextmanager
def _afloat(asked: argparse.Namespace) -> Iterator[tuple[Path, Team, Onlooker]]:
    """A place, this program in it, and who looks on."""
    with tempfile.TemporaryDirectory(prefix="delfim-bench-") as name:
        place = Path(name)
        (place / "delfim").mkdir()
        with _team(asked, place) as team, Onlooker(team.interface) as look:
            yield place, team, look


@contextlib.contextmanager
def _team(asked: argparse.Namespace, place: Path) -> Iterator[Team]:
    with tempfile.TemporaryDirectory(prefix="delfim-bench-") as programs:
        asked = argparse.Namespace(**vars(asked) | {"set": [*asked.set, *SETTINGS]})
        with Team("delfim", (asked.rates or [RATE_HZ])[0], asked, build(Path(programs)), place / "delfim") as team:
            yield team


@contextlib.contextmanager
def _clients(module: str = "bench.load", *words: str) -> Iterator["subprocess.Popen[bytes]"]:
    command = [*ASHORE, sys.executable, "-m", module, *words]
    with running(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as clients:
        yield clients


def _turn(team: Team, look: Onlooker, clients: "subprocess.Popen[bytes] | None", seconds: float, *, watchers: int = 0) -> Turn:
    part = team.turn(seconds, clients, watchers=watchers, flood=True)
    paths = look.paths_us(part.begin_ns, part.end_ns)
    return Turn(paths, part.due, team.state["log"]["dropped"], 0.0, team.state["log"]["reason"], part, team.state)


def _troubled(
    team: Team, look: Onlooker, clients: "subprocess.Popen[bytes] | None", seconds: float, begin: Trouble, end: Trouble
) -> Turn:
    """A turn with trouble in the middle of it, and then time to get over it."""
    dropped = team.state.get("log", {}).get("dropped", 0)
    failures, reasons = list[BaseException](), list[str]()

    def trouble() -> None:
        try:
            time.sleep(team.warm_s + MARGIN * seconds)
            until_s = time.monotonic() + (1.0 - 2.0 * MARGIN) * seconds  # who answers stops with the turn
            begin()
            while True:
                reasons.append(_log(team)["reason"])
                if time.monotonic() > until_s:
                    break
                time.sleep(LOOK_S)
        except BaseException as error:
            failures.append(error)
        finally:
            end()

    thread = threading.Thread(target=trouble)
    thread.start()
    try:
        turn = _turn(team, look, clients, seconds)
    finally:
        thread.join()
    if failures:
        raise failures[0]
    ended_s = time.monotonic()
    team.go_on()
    while not _log(team)["writable"]:
        if time.monotonic() - ended_s > MEND_S:
            raise DelfimError(f"the log did not come back within {MEND_S:g} s: {_log(team)['reason']}")
        time.sleep(0.1)
    mended_s = time.monotonic() - ended_s
    time.sleep(SETTLE_S)
    team.state["log"] = said = _log(team)
    team.hold()
    return turn._replace(dropped=said["dropped"] - dropped, mended_s=mended_s, reason=max(reasons, key=len))


def _log(team: Team) -> dict[str, Any]:
    with Link(team.socket, ANSWER_S) as link:
        said: dict[str, Any] = link.ask("state")["log"]
    return said


class _Killer:
    """Kills the writers of the logs, again and again."""

    def __init__(self, team: Team) -> None:
        self._team, self._ended = team, threading.Event()

    def start(self) -> None:
        self._ended.clear()
        threading.Thread(target=self._work, daemon=True).start()

    def stop(self) -> None:
        self._ended.set()

    def _work(self) -> None:
        while True:
            for pid in self._team.writers():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            if self._ended.wait(KILL_EVERY_S):
                return


def _renew(disk: Disk, place: Path) -> None:
    """What cannot be mended is replaced."""
    disk.mount()
    prepare(place / "delfim" / "log")


def _nothing() -> None:
    pass


def _rows(turns: dict[str, list[Turn]], undisturbed: str) -> list[dict[str, Any]]:
    """The figures of each case, the undisturbed one first, and what may be said of it."""
    halves = [sorted(path for turn in turns[""][start::2] for path in turn.paths_us) for start in (0, 1)]
    factors = report.noise_of(*halves)
    rows: list[dict[str, Any]] = []
    for name in sorted(turns, key=bool):
        its = turns[name]
        paths, due = sorted(path for turn in its for path in turn.paths_us), sum(turn.due for turn in its)
        row: dict[str, Any] = {"case": name or undisturbed, "cycles": len(paths), "lost": max(due - len(paths), 0)}
        for key, part in report.PERCENTILES.items():
            row[f"{key}_us"] = report.percentile(paths, part, due)
        row |= {"worst_us": paths[-1] if paths else 0.0, "dropped": sum(turn.dropped for turn in its)}
        row |= {"mended_s": max(turn.mended_s for turn in its), "reason": its[0].reason}
        shares = [
            turn.slice.cpu_ns_per_cycle / 1e9 * turn.slice.due / (turn.slice.end_ns - turn.slice.begin_ns) * 1e9 for turn in its
        ]
        row["cpu_share"] = round(sum(shares) / len(shares), 4)
        rows.append(row)
    taken = [turn.slice.others_share + turn.slice.steal_share for its in turns.values() for turn in its]
    return [row | report.compared(row, rows[0], factors, sum(taken) / len(taken), LIMITS) | {"noise": factors} for row in rows]


def _watched(turns: list[Turn], rows: list[dict[str, Any]], frames_per_s: int) -> dict[str, Any]:
    """What eight clients cost, and what they lost."""
    lost = [[each.get("dropped", 0) for each in _served(turn).values()] for turn in turns]
    share = (rows[1]["cpu_share"] - rows[0]["cpu_share"]) / WATCHERS
    return {
        "core_share_per_client": round(share, 5),
        "cpu_ms_per_1000_frames": round(share * 1e3 / frames_per_s * 1e3, 4),
        "lost_awake": sum(sum(sorted(each)[:-1]) for each in lost),
        "lost_asleep": sum(max(each, default=0) for each in lost),
    }


def _served(turn: Turn) -> dict[str, Any]:
    clients: dict[str, Any] = turn.state["services"]["cantcpd"]["figures"]["clients"]
    return clients


def _write(asked: argparse.Namespace, name: str, rows: list[dict[str, Any]], **more: object) -> None:
    output = Path(asked.output)
    output.mkdir(parents=True, exist_ok=True)
    (output / f"{name}.json").write_text(json.dumps({"rows": rows} | more, indent=1) + "\n")


def _table(rows: list[dict[str, Any]], more: tuple[str, ...], cells: Callable[[dict[str, Any]], tuple[object, ...]]) -> str:
    names = ("cycles", "lost", "p50", "p99", "p99.9", "worst", "p50 x", "p99 x", *more)
    lines = [f"{'us, on a full bus':35}" + "".join(f"{name:>{_width(name)}}" for name in names)]
    for row in rows:
        figures = [row[f"{key}_us"] for key in (*report.PERCENTILES, "worst")]
        words = [row["cycles"], row["lost"], *("lost" if each is None else f"{each:.0f}" for each in figures)]
        words += ["-" if row["ratio"][key] is None else f"{row['ratio'][key]:.2f}" for key in ("p50", "p99")]
        words += cells(row)
        lines.append(f"{row['case']:35}" + "".join(f"{word:>{_width(name)}}" for word, name in zip(words, names, strict=True)))
    noise = ", ".join(f"{key} x {factor:.2f}" if factor else f"{key} unknown" for key, factor in rows[0]["noise"].items())
    lines.append(f"  noise, {rows[0]['case']} against itself: {noise}")
    lines += [
        f"  p99 with {row['case']} <= {LIMITS['p99']:g} x that with {rows[0]['case']}: {row['verdict']['p99']}"
        for row in rows[1:]
    ]
    return "\n".join(lines)


def _width(name: str) -> int:
    return max(8, len(name) + 2)


def _say(text: str) -> None:
    print(f"delfim: {text}", file=sys.stderr, flush=True)

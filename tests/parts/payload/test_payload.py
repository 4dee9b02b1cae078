"""Payload programs: the shipped examples, and programs that flood, crash, eat, fork, and do not read."""

import asyncio
import contextlib
import errno
import gzip
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.errors import ConfigError
from delfim.parts.payload import payload
from delfim.parts.payload.table import PayloadTable
from delfim.services import report_feed
from delfim.services.runtime import LoadedService, Runtime
from delfim.services.supervision import processes
from delfim.vehicle.orders.payloadlines import LINE_BYTES, VALUES, BoundedLines, lines, values
from delfim.vehicle.report import Announced, BoatReport
from tests.afloat import running
from tests.services.boat import STATE, served, vehicle, vehicle_file

ROOT = Path(__file__).parents[3]
PYTHON = "/usr/bin/python3" if os.getuid() == 0 else sys.executable  # one that nobody in particular may run
as_root = pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
needs_python = pytest.mark.skipif(not os.access(PYTHON, os.X_OK), reason=f"needs {PYTHON}")
SOUNDER = (PYTHON, "-c", (ROOT / "etc/payloads/sounder.py").read_text())
REPORTS_AND_WAITS = ("/bin/sh", "-c", """while read line; do echo '{"well": true}'; done""")


class Suite:
    """The service with its programs, and a vehicle that they hear of."""

    def __init__(self, runtime: Runtime, state: dict[str, Any], publish: Callable[[], None]) -> None:
        self._runtime, self._publish, self.state = runtime, publish, state

    @property
    def figures(self) -> dict[str, Any]:
        return dict(self._runtime.board["payload"]())

    async def until(self, condition: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """Sail on until the figures are so."""
        async with asyncio.timeout(200):
            while not condition(figures := self.figures):
                self.state["cycle"] += 1
                self.state["utc_ns"] += 200_000_000
                self._publish()
                await asyncio.sleep(0.02)
        return figures


@contextlib.asynccontextmanager
async def carried(tmp_path: Path, **programs: tuple[str, ...] | PayloadTable) -> AsyncIterator[Suite]:
    tables = {name: each if isinstance(each, PayloadTable) else PayloadTable(command=each) for name, each in programs.items()}
    quick = config.SupervisorTable(backoff_s=0.01, backoff_max_s=0.1)
    settings = vehicle_file(tmp_path, payload=tables, supervisor=quick)
    state = STATE | {"course_deg": 90.0}
    async with vehicle(settings, state) as commands, served(settings, payload.serve, "payload") as runtime:
        yield Suite(runtime, state, commands.publish)


def logged(tmp_path: Path, name: str) -> list[dict[str, Any]]:
    """The log of a program that has ended."""
    (file,) = tmp_path.glob(f"log/*/payload-{name}/*.jsonl.gz")
    return [json.loads(line) for line in gzip.decompress(file.read_bytes()).splitlines()]


def living(words: str) -> list[int]:
    """Shells that have these words among their own."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            told = (place / "cmdline").read_bytes()
            if told.startswith(b"/bin/sh") and words.encode() in told:
                found.append(int(place.name))
    return found


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user may read."""
    with tempfile.TemporaryDirectory(prefix="payload-") as folder:
        os.chmod(folder, 0o755)
        yield Path(folder)


KNOCKS = """import json, socket, sys
for family, place in ((socket.AF_INET, ("127.0.0.1", int(sys.argv[1]))), (socket.AF_UNIX, sys.argv[2])):
    with socket.socket(family) as door:
        print(json.dumps({family.name: door.connect_ex(place) == 0}), flush=True)
for line in sys.stdin:
    print('{"told": true}', flush=True)
"""


@needs_python
async def test_a_program_has_no_network_unless_its_table_says_so_and_is_told_and_heard_all_the_same(tmp_path: Path) -> None:
    """Neither a door on this computer, nor a socket without a file, as the canloop of a simulation is."""
    hidden = f"\0payload {os.getpid()}"
    with socket.create_server(("127.0.0.1", 0)) as door, socket.socket(socket.AF_UNIX) as abstract:
        abstract.bind(hidden)
        abstract.listen()
        words = (
            PYTHON,
            "-c",
            KNOCKS.replace("sys.argv[1]", str(door.getsockname()[1])).replace("sys.argv[2]", repr(hidden)),
        )
        open_one = PayloadTable(command=words, network=True)
        async with carried(tmp_path, alone=words, open=open_one) as suite:
            figures = await suite.until(lambda it: {"alone told", "open told"} <= it["values"].keys())
    reached = {name: each["value"] for name, each in figures["values"].items() if "AF_" in name}
    assert reached == {"alone AF_INET": False, "alone AF_UNIX": False, "open AF_INET": True, "open AF_UNIX": True}


@needs_python
async def test_the_example_in_python_reports_a_depth_that_is_logged_and_shown(tmp_path: Path) -> None:
    async with carried(tmp_path, sounder=SOUNDER) as suite:
        figures = await suite.until(lambda it: it["lines"]["sounder"]["reported"] > 3)
        assert 9.0 <= figures["values"]["sounder depth_m"]["value"] <= 15.0
        assert figures["values"]["sounder bottom"]["value"] in ("mud", "sand")
        assert figures["values"]["sounder depth_m"]["age_s"] >= 0.0
        assert figures["troubles"] == {}
        assert figures["programs"]["sounder"]["state"] == "running"
    told = logged(tmp_path, "sounder")
    assert len(told) > 3
    assert json.loads(told[0]["text"]).keys() == {"depth_m", "bottom"}


@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
async def test_the_example_in_c_measures_the_way(tmp_path: Path, open_folder: Path) -> None:
    program, warnings = open_folder / "way", ("-Wall", "-Wextra", "-Werror")
    subprocess.run(("cc", "-O2", *warnings, "-o", program, ROOT / "etc/payloads/way.c", "-lm"), check=True)
    program.chmod(0o755)
    async with carried(tmp_path, way=(str(program),)) as suite:
        figures = await suite.until(lambda it: it["lines"]["way"]["reported"] > 5)
        assert figures["values"]["way fastest_mps"]["value"] == 1.31
        assert figures["values"]["way way_m"]["value"] > 0.5


async def test_a_program_that_does_not_want_to_end_is_dead_before_the_service_is(tmp_path: Path, monkeypatch: Any) -> None:
    """The loop may end next: what it does not know to be dead by then it calls running."""
    codes, run_, made = list[int | None](), payload.Payload.run, payload.Payload.connection_made
    started = list[asyncio.SubprocessTransport]()

    async def watched(self: payload.Payload) -> None:
        try:
            await run_(self)
        finally:
            codes.append(started[-1].get_returncode())

    def noted(self: payload.Payload, transport: asyncio.SubprocessTransport) -> None:
        started.append(transport)
        made(self, transport)

    monkeypatch.setattr(payload.Payload, "run", watched)
    monkeypatch.setattr(payload.Payload, "connection_made", noted)
    deaf = ("/bin/sh", "-c", """trap '' TERM; while :; do echo '{"x": 1}'; sleep 0.1; done""")
    async with carried(tmp_path, deaf=deaf) as suite:
        await suite.until(lambda it: it["lines"]["deaf"]["reported"])
    assert codes == [-signal.SIGKILL]


async def test_a_program_that_crashes_is_started_again_and_says_why_and_the_other_runs_on(tmp_path: Path) -> None:
    crash = ("/bin/sh", "-c", "echo no instrument there >&2; exit 3")
    async with carried(tmp_path, camera=crash, well=REPORTS_AND_WAITS) as suite:
        figures = await suite.until(lambda it: it["programs"]["camera"]["restarts"] >= 3 and it["values"])
        assert figures["last_ends"] == {"camera": "exit code 3: no instrument there"}
        assert figures["troubles"]["camera"].endswith("exit code 3: no instrument there")
        assert figures["programs"]["well"]["restarts"] == 0


async def test_a_program_that_an_operator_stops_is_gone_and_comes_back_when_he_says_so(tmp_path: Path) -> None:
    stubborn = ("/bin/sh", "-c", """trap '' TERM; while :; do read line && echo '{"stubborn": true}'; done""")
    async with carried(tmp_path, stubborn=stubborn, well=REPORTS_AND_WAITS) as suite:
        await suite.until(lambda it: "stubborn stubborn" in it["values"])
        suite.state["resting"] = ["stubborn"]
        figures = await suite.until(lambda it: it["programs"]["stubborn"]["state"] == "stopped")
        assert living("stubborn") == []
        assert figures["troubles"] == {}, "it was wanted"
        assert figures["programs"]["well"]["state"] == "running"
        reported = figures["lines"]["stubborn"]["reported"]
        suite.state["resting"] = []
        figures = await suite.until(lambda it: it["lines"]["stubborn"]["reported"] > reported)
        assert figures["programs"]["stubborn"]["state"] == "running"


async def test_a_flood_is_slowed_down_dropped_and_counted_and_one_that_does_not_read_loses_lines(tmp_path: Path) -> None:
    flood = ("/bin/sh", "-c", """while :; do echo '{"x": 1}'; echo noise >&2; done""")
    async with carried(tmp_path, flood=flood, well=REPORTS_AND_WAITS) as suite:
        much = await suite.until(lambda it: it["lines"]["flood"]["dropped"] > 1000 and it["lines"]["flood"]["unread"] > 10)
        assert much["values"]["flood x"]["value"] == 1
        before = much["lines"]["well"]["reported"]
        await suite.until(lambda it: it["lines"]["well"]["reported"] > before + 5)
    assert len(logged(tmp_path, "flood")) >= 1


async def test_what_is_not_a_line_of_values_is_refused_and_counted(tmp_path: Path) -> None:
    says = (
        "/bin/sh",
        "-c",
        "echo nonsense; echo '{}'; echo '{\"depth_m\": 1e400}'; echo '{\"a b\": 1}'; echo '{\"d\": 2}'; cat >/dev/null",
    )
    async with carried(tmp_path, strange=says) as suite:
        figures = await suite.until(lambda it: it["values"])
        assert figures["lines"]["strange"]["refused"] == 4
        assert list(figures["values"]) == ["strange d"]


@as_root
@needs_python
async def test_it_is_another_user_without_can_sockets_or_a_way_to_more_rights(tmp_path: Path) -> None:
    look = """
import json, os, resource, socket, sys
try: told = {"can": socket.socket(29, 3, 1) and 0}
except OSError as error: told = {"can": error.errno}
status = dict(line.split(":\\t", 1) for line in open("/proc/self/status").read().splitlines())
told |= {"user": os.getuid(), "groups": len(os.getgroups()), "idle": os.sched_getscheduler(0)}
told |= {"first": int(open("/proc/self/oom_score_adj").read())}
told |= {"new_rights": int(status["NoNewPrivs"]) == 0, "files": len(os.listdir("/proc/self/fd")), "names": len(os.environ)}
told |= {"core": resource.getrlimit(resource.RLIMIT_CORE)[0], "session": os.getsid(0) == os.getpid(), "place": os.getcwd()}
print(json.dumps(told), flush=True)
sys.stdin.read()
"""
    async with carried(tmp_path, look=(PYTHON, "-c", look)) as suite:
        told = {name: each["value"] for name, each in (await suite.until(lambda it: it["values"]))["values"].items()}
        assert told["look can"] == errno.EACCES
        assert (told["look user"], told["look groups"]) == (65534, 1)
        assert (told["look idle"], told["look first"], told["look core"]) == (os.SCHED_IDLE, 1000, 0)
        assert (told["look new_rights"], told["look session"], told["look place"]) == (False, True, "/")
        assert told["look files"] == 4, "standard ones, and the folder that it looks at"
        assert told["look names"] <= 7, "nothing of the boat's environment"


@needs_python
async def test_one_that_wants_more_memory_than_its_own_fails_alone(tmp_path: Path) -> None:
    eats = PayloadTable(command=(PYTHON, "-c", "x = [bytearray(1 << 20) for _ in range(512)]"), memory_max_mb=64)
    async with carried(tmp_path, eats=eats) as suite:
        figures = await suite.until(lambda it: it["programs"]["eats"]["restarts"])
        assert "MemoryError" in figures["last_ends"]["eats"] or "more than its 64 MB" in figures["last_ends"]["eats"]


async def test_one_that_forks_for_ever_stays_within_its_number_and_none_is_left_behind(tmp_path: Path) -> None:
    mark = f"forks-{os.getpid()}"
    bomb = ("/bin/sh", "-c", "while :; do while :; do sleep 1; done & done", mark)
    async with carried(tmp_path, bomb=bomb, well=REPORTS_AND_WAITS) as suite:
        before = (await suite.until(lambda it: living(mark)))["lines"]["well"]["reported"]
        await suite.until(lambda it: it["lines"]["well"]["reported"] > before + 5)
        assert len(living(mark)) <= 16
    assert living(mark) == []


async def test_all_of_a_program_ends_with_it_its_children_in_the_background_too(tmp_path: Path) -> None:
    mark = f"leaves-{os.getpid()}"
    leaves = ("/bin/sh", "-c", "(while :; do sleep 1; done) & echo '{\"on\": 1}'; read line; exit 5", mark)
    async with carried(tmp_path, leaves=leaves) as suite:
        figures = await suite.until(lambda it: it["programs"]["leaves"]["restarts"] >= 2)
        assert figures["last_ends"]["leaves"] == "exit code 5"
        assert len(living(mark)) <= 3
    assert living(mark) == []


async def test_a_service_that_ends_while_a_program_starts_leaves_none_of_it(tmp_path: Path, monkeypatch) -> None:
    """Between its process and its pipes, when it has started others already, as it can be on a busy machine."""
    mark = f"starts-{os.getpid()}"
    loop, popen = asyncio.get_running_loop(), subprocess.Popen
    services, started = list[asyncio.Task[None]](), list[int]()

    def ending(*words: Any, **more: Any) -> subprocess.Popen[bytes]:
        program = popen(*words, **more)
        if mark in words[0]:
            started.append(program.pid)
            while len(living(mark)) < 2:
                os.sched_yield()
            loop.call_soon(services[0].cancel)
        return program

    monkeypatch.setattr(subprocess, "Popen", ending)
    program = ("/bin/sh", "-c", "(while :; do sleep 1; done) & read line", mark)
    settings = vehicle_file(tmp_path, payload={"starts": PayloadTable(command=program)})
    services.append(asyncio.create_task(payload.serve(Runtime(settings, SystemClock(), alone=True))))
    async with asyncio.timeout(200):
        await asyncio.wait(services)
    assert services[0].cancelled()
    assert len(started) == 1
    assert processes.members(started[0]) == []


@as_root
@pytest.mark.parametrize("user", ["no-such-user", "toor"])
async def test_without_an_unprivileged_user_it_does_not_run_and_is_not_tried_again(tmp_path: Path, user: str) -> None:
    async with carried(tmp_path, lost=PayloadTable(command=("/bin/true",), user=user)) as suite:
        figures = await suite.until(lambda it: it["programs"]["lost"]["state"] == "failed")
        assert figures["troubles"]["lost"] == f"failed: exit code 100: user: there is no {user}"


async def test_a_program_that_is_not_there_is_waited_for(tmp_path: Path) -> None:
    async with carried(tmp_path, late=("/no/such/program",)) as suite:
        figures = await suite.until(lambda it: it["programs"]["late"]["restarts"] >= 2)
        assert figures["last_ends"]["late"] == "exit code 127: /no/such/program: No such file or directory"


async def test_without_the_vehicle_the_programs_run_and_the_page_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(report_feed, "AGAIN_S", 0.01)
    tables = {"well": PayloadTable(command=("/bin/sh", "-c", """echo '{"on": 1}'; cat >/dev/null"""))}
    async with served(vehicle_file(tmp_path, payload=tables), payload.serve, "payload") as runtime:
        async with asyncio.timeout(200):
            while not (figures := dict(runtime.board["payload"]()))["values"]:
                await asyncio.sleep(0.01)
        assert figures["troubles"] == {"navigation": "the vehicle does not answer: No such file or directory"}


def test_the_vehicle_itself_starts_no_programs(tmp_path: Path) -> None:
    runtime = Runtime(vehicle_file(tmp_path, payload={"x": PayloadTable(command=("/bin/true",))}), SystemClock())
    with asyncio.Runner(loop_factory=runtime._new_loop) as runner:  # `main` would make the tests' own process a real-time one
        runner.run(runtime.run([LoadedService("payload", payload.serve)]))
    assert "services.payload.place = 'process'" in runtime.status["payload"].reason


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ('payload.x.command=["sonar"]', "absolute path"),
        ("payload.x.command=[]", "payload.x.command"),
        ('payload.x.user="nobody"', "payload.x.command"),
        ('payload.x={command=["/bin/true"], user="root"}', "does not run as root"),
    ],
)
def test_what_a_vehicles_file_may_not_say(words: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        config.load(ROOT / "etc/delfimx.toml", [words])


SAILS = BoatReport(
    mode="play", reason="operator", cycle=7, utc_ns=5, speed_mps=2.0, course_deg=90.0, heading_deg=91.0, mission="Doca"
)


def test_a_program_is_told_events_and_navigation_as_the_guest_is() -> None:
    first = [json.loads(line) for line in lines(SAILS, None)]
    assert first[0] == {"event": "mode", "mode": "play", "helmsman": "", "reason": "operator"}
    assert first[1] == {
        "utc_ns": 5, "latitude_deg": None, "longitude_deg": None, "heading_deg": 91.0, "north_mps": 0.0, "east_mps": 2.0,
        "mode": "play", "helmsman": "", "mission": "Doca", "leg": 0, "line": 0,
    }  # fmt: skip
    assert list(lines(SAILS, SAILS)) == [], "no new navigation"
    hold = BoatReport(mode="hold", reason="x" * 5000, cycle=8, mission="Doca")
    told = list(lines(hold, SAILS))
    assert [json.loads(line).get("mode") for line in told] == ["hold", "hold"]
    assert max(map(len, told)) < 4096
    other = BoatReport(mode="hold", reason="", cycle=8, mission="Tejo")
    assert [json.loads(line) for line in lines(other, hold)] == [{"event": "leg", "mission": "Tejo", "leg": 0}]
    items = tuple(Announced(number, 206, (25.0, None)) for number in (1, 2, 3))
    before, after = (BoatReport(mode="hold", reason="", announced=each) for each in (items[:2], items[1:]))
    assert [json.loads(line) for line in lines(after, before)] == [{"event": "action", "command": 206, "params": [25.0, None]}]


@pytest.mark.parametrize(
    ("line", "found"),
    [
        (
            b'{"depth_m": 3, "bottom": "mud", "on": true, "none": null}',
            {"depth_m": 3, "bottom": "mud", "on": True, "none": None},
        ),
        (b"", None),
        (b"[1]", None),
        (b"{}", None),
        (b'{"x": [1]}', None),
        (b'{"x": NaN}', None),
        (b'{"x": 1e300}', None),
        (b'{"x": 99999999999999999999999999}', None),
        (b'{"x": "%s"}' % (b"y" * 65), None),
        (b'{"x": "\\u001b[2J"}', None),
        (b'{"1x": 1}', None),
        (b'{"x": 1, %s}' % b" " * LINE_BYTES, None),
        (json.dumps({f"x{n}": n for n in range(VALUES + 1)}).encode(), None),
        (b"\xff", None),
    ],
)
def test_which_lines_are_values(line: bytes, found: object) -> None:
    assert values(line) == found


def test_lines_are_let_through_at_their_rate_whole_and_bounded() -> None:
    tap = BoundedLines(10.0, 3)
    assert tap.feed(b"a\nb", 0.0) == [b"a"]
    assert tap.feed(b"c\nd\ne\nf\n", 0.0) == [b"bc", b"d"]
    assert tap.dropped == 2
    assert tap.feed(b"g\nh\n", 0.1) == [b"g"]
    assert tap.dropped == 3
    for _ in range(10):
        assert tap.feed(b"x" * LINE_BYTES, 1.0) == []
    assert [len(line) for line in tap.feed(b"\ny\n", 1.0)] == [LINE_BYTES + 1, 1]


@given(st.lists(st.binary(max_size=3 * LINE_BYTES), max_size=8))
def test_nothing_that_a_program_writes_is_more_than_a_bounded_line(pieces: list[bytes]) -> None:
    tap = BoundedLines(5.0, 20)
    for at_s, piece in enumerate(pieces):
        for line in tap.feed(piece, float(at_s)):
            assert len(line) <= LINE_BYTES + 1
            assert values(line) is None or len(line) <= LINE_BYTES
        assert len(tap._rest) <= LINE_BYTES + 1


def test_a_session_is_counted_and_ended_together() -> None:
    with subprocess.Popen(("/bin/sh", "-c", "sleep 100 & sleep 100 & wait"), start_new_session=True) as program:
        while len(processes.members(program.pid)) < 3:
            pass
        assert processes.usage()[program.pid].processes == 3
        assert processes.usage()[program.pid].memory_bytes > 0
        processes.kill(program.pid)
        while processes.members(program.pid):  # a busy machine takes a moment to end them
            pass


@pytest.mark.long
def test_with_the_whole_suite_a_flood_is_seen_on_the_page_and_nobody_outlives_the_service(open_folder: Path) -> None:
    """It cannot command the vehicle, whose socket it sees."""
    socket_path = open_folder / "command"
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    mark = f"floods-{os.getpid()}"
    commands = f"""if [ -w {socket_path} ]; then echo '{{"commands": true}}'; else echo '{{"commands": false}}'; fi"""
    flood = f"""while :; do [ -S {socket_path} ] && {commands}; echo '{{"x": 1}}'; done # {mark}"""
    values = (
        f"payload.flood.command={json.dumps(['/bin/sh', '-c', flood])}",
        f'httpd.listen="127.0.0.1:{port}"',
        "mavlink.enabled=false",
    )

    def shown() -> dict[str, Any]:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/state") as page:
                state = json.load(page)
        except OSError:  # it does not run yet
            return {}
        return dict(((state["computer"] or {}).get("supervisor") or {}).get("payload", {}))

    with running(open_folder, 14550, *values):
        while not shown().get("figures", {}).get("lines", {}).get("flood", {}).get("dropped"):
            pass
        (before,) = living(mark)
        os.kill(shown()["pid"], 9)
        while before in living(mark):
            pass
        while not (again := shown().get("figures", {})).get("values") or not living(mark):
            pass
        assert again["values"]["flood x"]["value"] == 1
        assert again["values"]["flood commands"]["value"] is (os.getuid() != 0)
        assert again["programs"]["flood"]["state"] == "running"
    assert living(mark) == []

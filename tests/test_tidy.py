"""The style of this project, as far as a program can tell: what a reviewer should never have to say twice."""

import ast
import gc
import importlib
import logging
import re
import subprocess
import sysconfig
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from delfim.base.parts import OWN
from delfim.vehicle.state import State

ROOT = Path(__file__).parents[1]
MODULES = sorted((ROOT / "delfim").rglob("*.py"))
PLACES = "tests", "bench", "compliance", "docker", "etc", "manual", "safety"  # of programs beside the package
PROGRAMS = [*MODULES, *sorted(path for folder in PLACES for path in (ROOT / folder).rglob("*.py"))]
LINES_PER_FUNCTION = 60
LINES_PER_FILE = 500
LOOSE = 4  # files at the root of the package
FILES_PER_FOLDER = 15
DECLARATIONS = {"config.py"}  # of nothing but tables, as long as what they declare
BOTH_ENDS = {"Command", "Mission", "PathPoint", "Plan", "Profile", "Waypoint"}  # of a wire: the boat's, and the page's
SCHEMA = {"Check", "Memory", "Service"}  # names that /api/schema publishes
LOOKED_AT = (ast.stmt, ast.Attribute, ast.withitem)  # by the rules that walk through whole programs
UNFINISHED = re.compile(r"\b(TO" r"DO|FIX" r"ME|X" r"XX|raise Not" r"Implemented\w*)\b")
REGISTRIES = re.compile(
    r"py" r"pi\.org|python" r"hosted\.org|npm" r"js\.(org|com)|debian" r"\.org|proxy\.golang" r"\.org|crates" r"\.io"
)
OUR_MACHINES = re.compile(r"(?<![\w.$}-])/(home|Users|work|root/\.[a-z]+|opt/(wheels|pypi))/")


def _files() -> list[Path]:
    """Every file of the project, whether git knows it yet or not."""
    listing = subprocess.run(["git", "ls-files", "-coz", "--exclude-standard"], cwd=ROOT, capture_output=True, check=True)
    return [path for name in listing.stdout.decode().split("\0") if name and (path := ROOT / name).is_file()]


def _lines(paths: list[Path], words: re.Pattern[str]) -> list[str]:
    """The lines of these files, binary ones apart, in which the words occur, as file:line: text."""
    texts = ((path.relative_to(ROOT), path.read_bytes()) for path in paths)
    return [
        f"{name}:{number}: {line.strip()[:120]}"
        for name, text in texts
        if b"\0" not in text
        for number, line in enumerate(text.decode(errors="replace").splitlines(), 1)
        if words.search(line)
    ]


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def _walked(path: Path) -> list[tuple[str, ast.AST]]:
    """The nodes that some rule is about: most of a tree are names, constants and the like."""
    name = path.relative_to(ROOT)
    nodes = (node for node in ast.walk(_tree(path)) if isinstance(node, LOOKED_AT))
    return [(f"{name}:{getattr(node, 'lineno', 0)}", node) for node in nodes]


@pytest.fixture(autouse=True, scope="module")
def trees() -> Iterator[None]:
    """They are parsed once, and go after these tests. To look for circles among all that is new takes longer than to parse."""
    gc.disable()
    yield
    gc.enable()
    _walked.cache_clear()
    _tree.cache_clear()


def _nodes(paths: list[Path]) -> Iterator[tuple[str, ast.AST]]:
    for path in paths:
        yield from _walked(path)


def test_a_function_fits_on_one_screen() -> None:
    functions = ((at, node) for at, node in _nodes(PROGRAMS) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)))
    lengths = [(at, node.name, (node.end_lineno or 0) - node.lineno + 1) for at, node in functions]
    assert [each for each in lengths if each[2] > LINES_PER_FUNCTION] == []


def test_a_file_is_read_in_one_sitting() -> None:
    lengths = {str(path.relative_to(ROOT / "delfim")): len(path.read_text().splitlines()) for path in MODULES}
    assert {name for name, lines in lengths.items() if lines > LINES_PER_FILE} == DECLARATIONS


CROWDED = {"base", "parts/traffic"}  # not cut by subject yet; it only shrinks


def test_a_folder_has_one_subject() -> None:
    """A path is read aloud, and says whose a file is and what it is about: in few files, and few loose ones at the root."""
    inside = ROOT / "delfim"
    folders = Counter(str(path.parent.relative_to(inside)) for path in MODULES)
    assert folders.pop(".") <= LOOSE
    assert {folder for folder, files in folders.items() if files > FILES_PER_FOLDER} == CROWDED


def test_a_class_has_its_name_for_itself() -> None:
    places = defaultdict[str, list[str]](list)
    for at, node in _nodes(MODULES):
        if isinstance(node, ast.ClassDef):
            places[node.name].append(at)
    assert {name: at for name, at in places.items() if len(at) > 1 and name not in BOTH_ENDS | SCHEMA} == {}
    assert {name for name in BOTH_ENDS | SCHEMA if len(places[name]) < 2} == set()


def test_tasks_are_born_in_the_runtime_or_in_a_group_that_sees_their_end() -> None:
    born = [
        at
        for at, node in _nodes(MODULES)
        if isinstance(node, ast.Attribute)
        and node.attr in ("create_task", "ensure_future")
        and ast.unparse(node.value) != "group"
    ]
    waits_for_them = "delfim/services/runtime.py:", "delfim/services/supervision/processes.py:"
    assert [at for at in born if not at.startswith(waits_for_them)] == []
    groups = [node for _, node in _nodes(MODULES) if isinstance(node, ast.withitem) and "group" in ast.unparse(node).split()]
    assert {ast.unparse(node) for node in groups} == {"asyncio.TaskGroup() as group"}


def test_tests_do_not_sleep() -> None:
    tests = [
        path for path in PROGRAMS if "tests" in path.relative_to(ROOT).parts and not path.name.startswith(("guest_", "host_"))
    ]
    assert _lines(tests, re.compile(r"\btime\.sleep" r"\(|\bfrom time import .*\bsleep\b")) == []


CLOCKS = {"monotonic", "perf_counter", "process_time", "thread_time", "time"}


def _lasted(node: ast.AST, durations: set[str]) -> bool:
    """Whether this is how long something took: a difference with a reading of a clock, or a name for one."""
    for part in ast.walk(node):
        if isinstance(part, ast.BinOp) and isinstance(part.op, ast.Sub):
            calls = [each.func for each in ast.walk(part) if isinstance(each, ast.Call)]
            if any(isinstance(func, ast.Attribute) and func.attr in CLOCKS for func in calls):
                return True
        if isinstance(part, ast.Name) and part.id in durations:
            return True
    return False


def _stopwatches(function: ast.AST) -> Iterator[int]:
    """Lines that assert that something took less than a figure. A bound of patience has a name; lower bounds hold anywhere."""
    assigned = [node for node in ast.walk(function) if isinstance(node, ast.Assign) and _lasted(node.value, set())]
    durations = {
        name.id for node in assigned for target in node.targets for name in ast.walk(target) if isinstance(name, ast.Name)
    }
    for check in (node for node in ast.walk(function) if isinstance(node, ast.Assert)):
        for comparison in (node for node in ast.walk(check.test) if isinstance(node, ast.Compare)):
            sides = [comparison.left, *comparison.comparators]
            for less, operator, more in zip(sides, comparison.ops, sides[1:], strict=False):
                if isinstance(operator, ast.Gt | ast.GtE):
                    less, more = more, less
                if _lasted(less, durations) and not isinstance(more, ast.Name):
                    yield check.lineno


def test_tests_do_not_assert_how_long_something_took() -> None:
    """A busy machine is no failure: hand in a clock, wait for the event, or make it a row of the benchmark."""
    tests = [path for path in PROGRAMS if path.is_relative_to(ROOT / "tests")]
    found = {f"{path.relative_to(ROOT)}:{line}" for path in tests for line in _stopwatches(_tree(path))}
    assert found == set()


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("began_s = time.monotonic()\nassert time.monotonic() - began_s < 1.2", 1),
        ("took_s = loop.time() - began_s\nassert 0.1 < took_s <= LIMIT_S + 0.5", 1),
        ("assert 2.0 > time.perf_counter() - began_s", 1),
        ("assert time.monotonic() < deadline_s", 0),
        ("assert time.monotonic() - began_s < PATIENCE_S", 0),
        ("assert time.monotonic() - began_s >= 0.3", 0),
        ("took_s = clock.monotonic_s() - began_s\nassert took_s < 1.2", 0),
    ],
)
def test_what_asserts_how_long_something_took(text: str, count: int) -> None:
    assert len(list(_stopwatches(ast.parse(text)))) == count


def test_no_type_of_ours_is_imported_for_types_alone() -> None:
    """Whoever needs a type needs its file, and no circle hides behind quotation marks."""
    guarded = (
        (at, node) for at, node in _nodes(MODULES) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    )
    assert [at for at, node in guarded if "from delfim" in ast.unparse(node)] == []


def test_the_vehicle_does_not_know_that_it_is_simulated() -> None:
    assert (
        _lines([path for path in MODULES if "vehicle" in path.relative_to(ROOT).parts], re.compile("simulat", re.IGNORECASE))
        == []
    )


@pytest.mark.parametrize("words", [UNFINISHED, REGISTRIES, OUR_MACHINES], ids=["unfinished work", "registries", "our machines"])
def test_no_file_mentions(words: re.Pattern[str]) -> None:
    assert _lines(_files(), words) == []


def test_logging_is_the_standard_one() -> None:
    assert Path(str(logging.__file__)).is_relative_to(sysconfig.get_path("stdlib"))
    assert Path(str(importlib.import_module("delfim.logging").__file__)).is_relative_to(ROOT)


def test_every_public_module_says_what_it_does() -> None:
    public = [path for path in MODULES if not path.name.startswith("_") or path.name == "__init__.py"]
    assert [str(path.relative_to(ROOT)) for path in public if not ast.get_docstring(_tree(path))] == []


def test_every_document_is_reachable_from_the_readme() -> None:
    """A link to a folder reaches all files in it."""
    reached, ahead = set[Path](), [ROOT / "README.md", ROOT / "docs" / "README.md"]
    while ahead:
        page = ahead.pop()
        if page in reached or not page.exists():
            continue
        reached.add(page)
        if page.is_dir():
            ahead += [path for path in page.rglob("*") if path.is_file()]
        elif page.suffix == ".md":
            links = re.findall(r"(?:\]\(|^\[[^\]]+\]:\s*|(?:href|src)=\")(?!\w+:)([^)#\s\"]+)", page.read_text(), re.MULTILINE)
            ahead += [(page.parent / link).resolve() for link in links]
    documents = [path for path in _files() if path.is_relative_to(ROOT / "docs")]
    assert [str(path.relative_to(ROOT)) for path in documents if path not in reached] == []


CORE = (  # what every boat runs, whatever it owns
    *("vehicle/*", "vehicle/control/*", "vehicle/*/__init__", "vehicle/plans/*", "vehicle/navigation/*"),
    *("config", "logging/*", "services/supervision/*", "services/vehicle", "services/suite", "services/runtime"),
    *("services/priority/*", "services/servicestatus", "lines/*line"),
    *(f"base/{name}" for name in ("cooperative", "tables", "modes", "selection", "input/untrusted", "input/ratelimit")),
)
NAMED = {  # with the reason; a row that goes does not come back
    "config.py: dsor.rpm_max",  # where a key of older files went
    "config.py: sysstat",  # the nodes that it requires are those of other tables
    "services/suite.py: dronecan.interface",  # its own service's row
    "config.py: traffic",  # a table that others are checked with: it goes to its part
    "config.py: handset",  # its device is one of the serial lines: it goes with its table
    "vehicle/grex.py: guest",  # who tells of other vessels
    "vehicle/loop.py: guest",
    "vehicle/snapshot.py: guest",  # a name of the report, which pages and tools read
}


def test_the_core_names_no_part() -> None:
    """It asks their rows (`delfim/base/parts.py`)."""
    names, inside = (
        {each.name for each in OWN.values() if each.driver or each.source or each.sensor or each.aboard},
        ROOT / "delfim",
    )
    paths = {path for pattern in CORE for path in inside.glob(f"{pattern}.py")}
    texts = ((path, node.value) for path in paths for node in ast.walk(_tree(path)) if isinstance(node, ast.Constant))
    named = {
        f"{path.relative_to(inside)}: {text}"
        for path, text in texts
        if isinstance(text, str) and re.fullmatch(r"[a-z0-9_.]+", text) and text.partition(".")[0] in names
    }
    assert named == NAMED
    assert all(any(inside.glob(f"{pattern}.py")) for pattern in CORE)


KNOWN = {  # parts that others import, with the reason; a row that goes does not come back
    "commands/description/check.py: nmea2000",  # which messages the boat sends
    "console/gateway/gateway.py: fleet",  # and of the broker
    "console/link/mavlink.py: mavlink",  # the console is the other end of the link
    "console/boats/othervessels.py: traffic",  # whom it hears itself, it judges as the boat does
    "console/gateway/serving.py: fleet",
    "console/gateway/picturedesk.py: camera",
    "console/pictures/picturelink.py: camera",  # the other end of the pictures' way
    "console/tapes/statetape.py: nmea0183",  # the short names of measured values, as the link tells them
    "console/tapes/statetape.py: nmea2000",
    "desk/firstcontact.py: nmea0183",  # a line on a desk is heard as the boat hears it
    "parts/iridium/iridiumd.py: mavlink",  # the satellite carries frames of the same link
    "parts/iridium/orders.py: mavlink",
    "parts/iridium/reading.py: mavlink",
    "commands/operation/iridium.py: iridium",  # the shore is the other end of it
    "commands/operation/iridium.py: mavlink",
    "parts/nmea2000/sensor.py: nmea0183",  # the values that both measure
}
READ = {  # parts whose tables others read, with the reason; a row that goes does not come back
    "commands/description/check.py: nmea2000",  # what the boat sends
    "commands/description/commission.py: fleet",  # what is carried to a boat
    "commands/description/commission.py: ros",
    "console/tabletd.py: mavlink",  # aboard its key is the boat's
    "commands/simulation/sim.py: mavlink",  # the console beside a simulated boat
    "console/gateway/picturedesk.py: camera",  # where they are asked
    "desk/listen.py: nmea0183",  # a line on a desk is opened as the boat opens it
    "parts/camera/camerad.py: mavlink",  # the same key and address
    "parts/camera/exposure.py: mavlink",
    "parts/fleet/exposure.py: mavlink",
    "parts/iridium/exposure.py: mavlink",
    "parts/iridium/iridiumd.py: mavlink",
    "parts/fleet/fleetd.py: mavlink",  # the broker is another way for the same frames
    "parts/gnss/corrections.py: nmea0183",  # the receiver's port may be one of its lines
}


def test_a_part_is_imported_by_itself_alone() -> None:
    """Others load what its row names. The lists only shrink."""
    found, read = set[str](), set[str]()
    for at, node in _nodes(MODULES):
        if isinstance(node, ast.Import | ast.ImportFrom):
            file = at.removeprefix("delfim/").partition(":")[0]
            base = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
            names = (each for name in node.names if (each := f"{base}{name.name}".split("."))[:2] == ["delfim", "parts"])
            for _, _, part, *module in names:
                if not file.startswith(f"parts/{part}/"):
                    (read if module[:1] == ["table"] else found).add(f"{file}: {part}")
    assert (found, read) == (KNOWN, READ)


def test_tables_import_the_base_alone() -> None:
    """All of them are loaded with every vehicle's file, by whoever reads one."""
    inside = ROOT / "delfim"
    tables = [*inside.glob("parts/*/table.py"), *(path for path in inside.glob("*/tables.py") if path.parent.name != "base")]
    assert len(tables) > 10
    assert _lines(tables, re.compile(r"from delfim(?!\.base\.)|import delfim")) == []


def test_the_vehicles_state_is_changed_by_the_loop_alone() -> None:
    """By the loop and what it calls; a replay puts in what was recorded. To count what was refused is no change."""
    called = (
        "loop",
        *(
            "helm/helm",
            "helm/alone",
            "helm/stations",
            "helm/planning",
            "orders/handlers",
            "orders/entrusting",
            "orders/returning",
        ),
        "failsafe/failing",
        "navigation/fixes",
        "navigation/estimated",
        "../parts/dsor/sysstat",
        "../parts/energy/aboard",
        "../parts/handset/*",
        "../parts/*/driver",
        "../parts/*/sensor",
        "../parts/traffic/lookout",
        "../parts/traffic/watchkeeper",
        "../parts/frontseats/*",
        "../parts/torqeedo/torqlink",
        "../simulator/replay/rerun",
    )
    inside = ROOT / "delfim"
    loop = {str(path.resolve().relative_to(inside)) for name in called for path in inside.glob(f"vehicle/{name}.py")}
    changed = [
        at
        for at, node in _nodes([path for path in MODULES if str(path.relative_to(ROOT / "delfim")) not in loop])
        if isinstance(node, (ast.Assign, ast.AugAssign, ast.AnnAssign))
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        for each in ast.walk(target)
        if isinstance(each, ast.Attribute)
        and each.attr in State.__slots__
        and isinstance(each.value, (ast.Name, ast.Attribute))
        and (each.value.id if isinstance(each.value, ast.Name) else each.value.attr) in ("state", "_state")
    ]
    assert changed == []


def test_the_loop_is_one_page() -> None:
    assert len((ROOT / "delfim/vehicle/loop.py").read_text().splitlines()) <= 200

"""The command line from outside: the whole suite in real time on a loopback bus, and the same mission in lock step."""

import gzip
import json
import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from delfim.console.link import Link
from delfim.logging.statelog import columns, read_state

ROOT = Path(__file__).parents[1]
VEHICLE = str(ROOT / "etc/delfimx.toml")


def delfim(*words: str, **options: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "delfim", *words]
    return subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)


def sim(tmp_path: Path, *words: str) -> subprocess.Popen[str]:
    bus = f'simulation.interface="canloop:live-{os.getpid()}-{tmp_path.name[-8:]}"'
    ports = ("--set", 'cantcpd.listen=["127.0.0.1:0"]', "--set", 'simulation.httpd="127.0.0.1:0"')
    ports += ("--set", 'mavlink.listen="127.0.0.1:0"', "--set", "mavlink.peers=[]")
    return delfim("sim", VEHICLE, "--output", str(tmp_path / "out"), "--set", bus, *ports, *words)


def ended(process: subprocess.Popen[str]) -> tuple[str, str]:
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    return out, err


@pytest.fixture(scope="module")
def sailed(tmp_path_factory):
    """Ten seconds in real time: its states and its folder."""
    tmp_path = tmp_path_factory.mktemp("sailed")
    out, err = ended(sim(tmp_path, "--json", "--for", "10"))
    states = [json.loads(line) for line in out.splitlines() if line.startswith("{")]
    return states, tmp_path / "out", out, err


def test_the_boat_leaves_idle_and_plays_its_mission(sailed):
    states, _, out, _ = sailed
    assert states[-1]["mode"] == "play"
    assert states[-1]["cycle"] >= 40, "navigation at 5 Hz for 10 s"
    assert states[-1]["starboard_rpm"] or states[-1]["port_rpm"]
    assert "time: 10 s sailed" in out


def test_every_input_has_an_age_and_nothing_was_lost(sailed):
    state = sailed[0][-1]
    assert state["age_s"]["navigation"] < 1.0
    assert set(state["sysstat"]) == {"gps", "propeller_starboard", "propeller_port", "batteries_starboard", "batteries_port"}
    assert state["counts"] == {}
    states = {name: service["state"] for name, service in state["services"].items()}
    assert states == {
        "canzlogd": "running",
        "cantcpd": "running",
        "httpd": "running",
        "powerd": "running",
        "vehicle": "running",
    }


def test_pictures_and_logs_are_left_behind(sailed):
    _, folder, _, _ = sailed
    for picture in ("track.png", "latency.png"):
        assert (folder / picture).read_bytes().startswith(b"\x89PNG")
    files = list(folder.glob("log/*/state/*.state.gz"))
    assert [read_state(file).complaint for file in files] == [""], "closed in order"
    assert len(columns(files)["t0"]) >= 40
    box = list(folder.glob("log/*/*/*.log.gz"))
    assert len(box) == 1


def test_propulsion_was_stopped_first_and_the_logs_closed_last(sailed):
    """The black box holds the stop that the ending vehicle sent."""
    _, folder, _, _ = sailed
    lines = gzip.decompress(next(folder.glob("log/*/*/*.log.gz")).read_bytes()).decode().splitlines()
    commands = [line.split()[2] for line in lines if line.split()[2].startswith(("040#", "041#"))]
    assert commands[-2][:10] == "040#000000"
    assert commands[-1][:10] == "041#000000"


def test_what_was_sailed_repeats_bit_by_bit_from_its_logs(sailed):
    _, folder, _, _ = sailed
    out, _ = ended(delfim("log", "replay", str(folder / "log")))
    assert "all the same, bit by bit" in out


def test_a_killed_simulation_leaves_nothing_behind(tmp_path):
    process = sim(tmp_path, "--json")
    assert process.stdout is not None
    process.stdout.readline()
    socket = tmp_path / "out/command"
    with Link(socket) as link:
        link.ask("state")
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30)
    with pytest.raises(Exception, match="no vehicle"):
        Link(socket)


def test_what_surrounds_the_loop_breaks_by_command_and_is_whole_again(tmp_path):
    quick = ("log.after_s=0.2", "console_silent.after_s=5.0", "clear_s=0.1")
    process = sim(tmp_path, "--json", *(word for one in quick for word in ("--set", f"failsafe.{one}")))
    place = ("--set", f"runtime.run_directory='{tmp_path}/out'", "--set", f"console.socket='{tmp_path}/out/command'")
    assert process.stdout is not None
    states = (json.loads(line) for line in process.stdout if line.startswith("{"))

    def until(condition):
        return next(state for state in states if condition(state))

    def told(state):
        return {notice["name"]: notice["reason"] for notice in state["notices"]}

    def break_(*words):
        out, _ = ended(delfim("fault", VEHICLE, *place, *words))
        assert out.startswith(f"delfim: {words[0]}") or words[0] == "end"

    def check(state, name):
        return next(line for line in state["checks"] if line["name"] == name)

    try:
        until(lambda state: state["mode"] == "play")
        for kind in ("disk_full", "guest_lost", "clock_stepped"):
            break_(kind)
        full = until(lambda state: told(state).get("log") and not check(state, "clock")["ok"])
        assert told(full)["log"] == "log not written: no space left on device"
        assert re.search(r"(59|60)\.\d s off", check(full, "clock")["reason"])
        assert full["mode"] == "play", "the table says: go on"
        break_("console_lost")
        lost = until(lambda state: state["mode"] != "play")
        assert "console silent for " in lost["reason"]
        stop = delfim("drive", VEHICLE, *place, "stop")
        assert "not heard: console_lost" in stop.communicate(timeout=30)[1]
        break_("end")
        whole = until(lambda state: not state["notices"] and check(state, "clock")["ok"])
        assert whole["mode"] == lost["mode"], "nothing is resumed by itself"
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)


def test_two_simulations_on_one_bus_are_refused(tmp_path):
    first = sim(tmp_path, "--json")
    assert first.stdout is not None
    first.stdout.readline()
    second = sim(tmp_path, "--json", "--for", "1")
    _, err = second.communicate(timeout=30)
    first.send_signal(signal.SIGTERM)
    first.communicate(timeout=30)
    assert second.returncode == 2
    assert "in use by another simulation" in err


def test_lockstep_sails_the_whole_mission_and_repeats_itself_byte_for_byte(tmp_path):
    logs = []
    for name in ("one", "two"):
        out, _ = ended(delfim("sim", VEHICLE, "--lockstep", "--output", str(tmp_path / name)))
        assert "mission done" in out
        assert (tmp_path / name / "track.png").exists()
        logs.append([(file.name, file.read_bytes()) for file in sorted((tmp_path / name).glob("lockstep-1/*/state/*.state"))])
    assert logs[0]
    assert logs[0] == logs[1]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("check", "/no/such/file"), "No such file"),
        (("check", VEHICLE, "--set", "runtime.window=3"), "runtime.window"),
        (("check", VEHICLE, "--set", "nonsense"), "not KEY=VALUE"),
        (("drive", "--set", "console.socket='/no/such/socket'", VEHICLE, "stop"), "is it running"),
        (("run", VEHICLE, "--set", "services.nonsense.enabled=true"), "there is no such service"),
        (("drive", VEHICLE, "--set", "console.socket='/no/such/socket'", "heading", "90", "1.5"), "is it running"),
        (("drive", VEHICLE, "--sim", "state"), "no vehicle at run/sim/command"),
        (("fault", VEHICLE, "--sim", "end"), "nobody to break at run/sim/nodes"),
        (("sim", VEHICLE, "--output", f"{VEHICLE}/nobody"), "nobody: Not a directory"),
        (("supervise", VEHICLE, "--set", f"runtime.run_directory='{VEHICLE}/nobody'"), "nobody: Not a directory"),
        (("console", "--no-browser", "--page", "127.0.0.1:65536"), "no address"),
    ],
)
def test_mistakes_are_one_line_on_standard_error(tmp_path, words, reason):
    process = delfim(*words, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)})
    out, err = process.communicate(timeout=30)
    assert process.returncode in (2, 100)
    assert reason in err
    assert err.count("\n") == 1
    assert not out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("log", "--help"), "replay"),
        (("can", "--help"), "candump"),
        (("sim", VEHICLE, "--for", "-3"), "--for: -3 is no number of seconds above 0"),
        (("check", VEHICLE, "--fast"), "unrecognized arguments: --fast"),
    ],
)
def test_the_command_line_explains_itself(words, told):
    process = delfim(*words)
    out, err = process.communicate(timeout=30)
    assert told in out + err
    assert "Traceback" not in err


def test_black_box_and_page_work_in_processes_of_their_own_and_a_guest_steers(tmp_path):
    """`place = "process"`, the guest computer over TCP, and the operator's words, all of them real programs."""
    port = 20_000 + os.getpid() % 20_000
    apart = (word for name in ("canzlogd", "httpd") for word in ("--set", f'services.{name}.place="process"'))
    page = ("--set", f'simulation.httpd="127.0.0.1:{port + 1}"')
    settings = (*apart, *page, "--set", f'guest.listen="127.0.0.1:{port}"')
    process = sim(tmp_path, "--json", "--for", "20", *settings)
    guest = delfim("guest", VEHICLE, "--set", f'guest.listen="127.0.0.1:{port}"', "--course", "150")
    modes = []
    assert process.stdout is not None
    for line in process.stdout:
        if not line.startswith("{"):
            continue
        state = json.loads(line)
        if not modes and state["age_s"]["guest"] is not None and state["mode"] == "play":
            with Link(tmp_path / "out/command") as operator:
                operator.ask("mode", mode="grex")
        if state["mode"] == "grex":
            modes.append(state)
            if len(modes) > 10:
                with urllib.request.urlopen(f"http://127.0.0.1:{port + 1}/api/state") as answer:
                    seen = json.load(answer)
                break
    guest.terminate()
    guest.communicate(timeout=30)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30)
    assert modes, "grex was entered"
    assert modes[-1]["reference"]["heading_deg"] == pytest.approx(180.0), "course 150, 30 to starboard"
    assert set(modes[-1]["services"]) == {"cantcpd", "powerd", "vehicle"}, "the others are not in this process"
    assert seen["vehicle"]["mode"] == "grex"
    assert set(seen["services"]) >= {"vehicle", "httpd"}
    assert set(seen["computer"]["supervisor"]) == {"runtime", "canzlogd", "httpd"}
    assert list((tmp_path / "out").glob("log/*/*/*.log.gz")), "and works"

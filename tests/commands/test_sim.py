"""The command line from outside: the whole suite in real time on a loopback bus, and the same mission in lock step."""

import gzip
import json
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from delfim import config
from delfim.__main__ import main
from delfim.commands.simulation import sim as sim_command
from delfim.logging.statelog import columns, read_state
from delfim.vehicle.operator.link import Link

ROOT = Path(__file__).parents[2]
VEHICLE = str(ROOT / "etc/delfimx.toml")


def delfim(*words: str, **options: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "delfim", *words]
    return subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)


def sim(tmp_path: Path, *words: str, **options: object) -> subprocess.Popen[str]:
    bus = f'simulation.interface="canloop:live-{os.getpid()}-{tmp_path.name[-8:]}"'
    ports = ("--set", 'cantcpd.listen=["127.0.0.1:0"]', "--set", 'simulation.httpd="127.0.0.1:0"')
    ports += ("--set", 'mavlink.listen="127.0.0.1:0"', "--set", "mavlink.peers=[]")
    return delfim("sim", VEHICLE, "--output", str(tmp_path / "out"), "--set", bus, *ports, *words, **options)


def ended(process: subprocess.Popen[str]) -> tuple[str, str]:
    out, err = process.communicate(timeout=200)
    assert process.returncode == 0, out + err
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
    assert any(each["thrust"] for each in states[-1]["thrusters"].values())
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


@pytest.mark.long
def test_a_killed_simulation_leaves_nothing_behind(tmp_path):
    process = sim(tmp_path, "--json")
    assert process.stdout is not None
    process.stdout.readline()
    where = tmp_path / "out/command"
    with Link(where) as link:
        link.ask("state")
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=200)
    with pytest.raises(Exception, match="no vehicle"):
        Link(where)


@pytest.fixture
def typed(capsys):
    """`delfim ...` typed beside a simulation, in this process: one that starts would take long enough on a busy machine for the
    pipe of the simulation to fill, and its operator to fall silent. Returns exit code, output and errors."""

    def run(*words: str) -> tuple[int, str, str]:
        code = main(list(words))
        return code, *capsys.readouterr()

    return run


@pytest.mark.long
def test_what_surrounds_the_loop_breaks_by_command_and_is_whole_again(tmp_path, typed):
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
        code, out, _ = typed("fault", VEHICLE, *place, *words)
        assert code == 0
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
        assert "not heard: console_lost" in typed("drive", VEHICLE, *place, "stop")[2]
        break_("end")
        whole = until(lambda state: not state["notices"] and check(state, "clock")["ok"])
        assert whole["mode"] == lost["mode"], "nothing is resumed by itself"
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=200)


def until(process: subprocess.Popen[str], condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The first such state that a simulation prints."""
    assert process.stdout is not None
    return next(state for line in process.stdout if line.startswith("{") and condition(state := json.loads(line)))


def interrupted(process: subprocess.Popen[str]) -> str:
    """What a simulation says when Ctrl-C ends it."""
    process.send_signal(signal.SIGINT)
    return ended(process)[0]


@pytest.mark.long
def test_a_second_simulation_has_a_folder_a_bus_ports_and_a_boat_of_its_own(tmp_path, typed, monkeypatch):
    """Each with nothing but its file, in the same folder."""
    monkeypatch.chdir(tmp_path)
    first = delfim("sim", VEHICLE, "--json", cwd=tmp_path)
    one = until(first, lambda state: state["mode"] == "play")
    second = delfim("sim", VEHICLE, "--json", cwd=tmp_path)
    until(second, lambda state: state["mode"] == "play")
    places = sorted(path.parent for path in tmp_path.glob("run/*/command"))
    assert len(places) == 2
    said = " and ".join(str(place.relative_to(tmp_path)) for place in places)
    assert f"simulations run in {said}: choose one: --sim-in {said.split()[-1]}" in typed("drive", VEHICLE, "--sim", "stop")[2]
    its = [json.loads((place / "supervisor.json").read_text())["pid"] for place in places]
    assert its[0] != its[1]
    assert typed("drive", VEHICLE, "--sim-in", str(places[1]), "speed", "0.7")[0] == 0
    slow = until(second, lambda state: state["reference"]["speed_override_mps"] == 0.7)
    with Link(places[0] / "command") as link:
        other = link.ask("state")
    assert (other["mode"], other["reference"]["speed_override_mps"]) == ("play", None), "the first one was told nothing"
    assert slow["mode"] == "play"
    assert other["cycle"] > one["cycle"], "and was not started again"
    for process in (second, first):
        assert "delfim: ended by Ctrl-C" in interrupted(process)


@pytest.mark.long
def test_a_folder_or_a_bus_of_another_simulation_is_refused(tmp_path):
    first = sim(tmp_path, "--json")
    until(first, lambda state: True)
    for words, why in (
        (("--output", str(tmp_path / "out")), f"--output {tmp_path}/out: another simulation runs there; name another folder"),
        (("--output", str(tmp_path / "other")), "is in use by another simulation"),
    ):
        _, err = sim(tmp_path, "--json", *words, "--for", "1").communicate(timeout=200)
        assert why in err
        assert "Traceback" not in err
    interrupted(first)


@pytest.mark.long
def test_ctrl_c_ends_also_what_a_script_put_into_the_background_with_a_summary_and_the_pictures(tmp_path):
    def background() -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    process = sim(tmp_path, "--json", preexec_fn=background)
    until(process, lambda state: state["cycle"] > 20 and state["mode"] == "play")
    out = interrupted(process)
    told = dict(re.findall(r"^  (\w[\w-]*) +(.*)$", out, re.MULTILINE))
    assert "delfim: ended by Ctrl-C" in out
    assert re.fullmatch(r"0:0\d:\d\d", told["time"])
    assert re.fullmatch(r"\d+ m", told["distance"])
    assert re.fullmatch(r"\d+\.\d\d m rms, \d+\.\d\d m at most, while the mission was played", told["cross-track"])
    assert told["log"] == str(tmp_path / "out/log")
    assert all(Path(picture).exists() for picture in told["pictures"].split(", "))


@pytest.mark.long
def test_with_a_console_a_stop_ends_nothing_and_the_address_is_told(tmp_path, typed):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        busy = taken.getsockname()[1]
        wanted = sim(tmp_path, "--console", "--page", f"127.0.0.1:{busy}")
        _, err = wanted.communicate(timeout=200)
        assert wanted.returncode == 2
        assert re.search(rf"--page: 127.0.0.1:{busy}: another program has it, .*--page ADDRESS:PORT", err)
        assert "the console did not start" in err
    process = sim(tmp_path, "--console", "--page", "127.0.0.1:0", "--boats", "127.0.0.1:0", "--plain")
    assert process.stdout is not None
    told = next(line for line in process.stdout if "the console is at http://127.0.0.1:" in line)
    assert "boats are heard on" in told
    until_line(process, " play ")
    assert typed("drive", VEHICLE, "--sim-in", str(tmp_path / "out"), "stop")[0] == 0
    until_line(process, " idle ")
    assert typed("drive", VEHICLE, "--sim-in", str(tmp_path / "out"), "hold")[0] == 0
    until_line(process, " hold ")
    assert "delfim: ended by Ctrl-C" in interrupted(process)


def until_line(process: subprocess.Popen[str], words: str) -> str:
    assert process.stdout is not None
    return next(line for line in process.stdout if re.match(r"0:\d\d:\d\d ", line) and words in line)


def test_what_is_found_of_a_simulated_boat_is_not_written_into_the_file_of_the_real_one(tmp_path):
    """The console beside it has a copy, of the same boat and mission; a copy that is sailed is its own."""
    file, beside = str(tmp_path / "boat.toml"), tmp_path / "console"
    assert main(["new", file, "--yes"]) == 0
    text = Path(file).read_text()
    copy = sim_command._copied(file, beside, 3)
    assert Path(copy).parent == beside
    assert config.mission_place(copy, config.load(copy)) == tmp_path / "boat-mission.toml"
    assert (config.load(copy).boat.id, config.load(copy).sails_by) == (3, config.load(file).sails_by)
    assert sim_command._copied(copy, beside, 4) == copy
    assert config.load(copy).boat.id == 3
    assert Path(file).read_text() == text
    inline = tmp_path / "inline.toml"
    inline.write_text('boat = { name = "x", id = 9 }\n')
    assert Path(sim_command._copied(str(inline), beside, 3)).read_text() == inline.read_text()


@pytest.mark.long
def test_a_boat_with_a_second_bus_sails_its_own_mission_tells_no_trouble_and_is_repeated(tmp_path, typed):
    """That of the sensors is simulated, too: a receiver and a compass are on it, and the estimator makes navigation of them.
    Until it does, the boat's own node is the source. A spare receiver is on a pty, sounder and wind vane speak by datagrams."""
    process = delfim("sim", str(ROOT / "etc/sensors.toml"), "--json", cwd=tmp_path)
    state = until(process, lambda state: state["mode"] == "play" and "depth_m" in state["measured"])
    assert state["source"] == "nmea2000"
    ports = state["nmea0183"]["ports"]
    assert {name: set(port["heard"]) for name, port in ports.items()} == {
        "gnss": {"GPGGA", "GPRMC", "GPGST"},
        "compass": {"HCHDG", "TIROT"},
        "masthead": {"SDDPT", "WIMWV"},
    }
    _, heard, _ = typed("sensors", str(ROOT / "etc/sensors.toml"), "--sim-in", str(tmp_path / "run/sim"), "--for", "2")
    assert heard.startswith("Sensors: the boat runs: these are its own figures; it navigates by nmea2000\n")
    assert re.search(r"^nmea2000 +heading +204 +[0-9.]+ s +[0-9.]+ deg$", heard, re.MULTILINE)
    assert re.search(r"^nmea0183 compass .* HCHDG [0-9.]+, TIROT [0-9.]+$", heard, re.MULTILINE)
    assert re.search(r"^depth_m +1[12]\.[0-9]+$", heard, re.MULTILINE)
    out = interrupted(process)
    assert re.search(r"^  troubles +none$", out, re.MULTILINE)
    code, told, _ = typed("log", "replay", str(tmp_path / "run/sim/log"))
    assert (code, "all the same, bit by bit" in told) == (0, True), told


@pytest.mark.long
def test_lockstep_sails_the_whole_mission_and_repeats_itself_byte_for_byte(tmp_path):
    logs = []
    for name in ("one", "two"):
        out, _ = ended(delfim("sim", VEHICLE, "--lockstep", "--output", str(tmp_path / name)))
        assert "mission done" in out
        assert (tmp_path / name / "track.png").exists()
        logs.append([(file.name, file.read_bytes()) for file in sorted((tmp_path / name).glob("lockstep-1/*/state/*.state"))])
    assert logs[0]
    assert logs[0] == logs[1]


def test_the_soundings_of_a_run_in_lock_step_are_in_its_log(tmp_path, typed):
    sounder = ("--set", 'sensors.names=["sysstat", "nmea2000"]', "--set", "simulation.sea_bed.mean_m=7")
    assert typed("sim", VEHICLE, "--lockstep", "--for", "60", "--output", str(tmp_path), *sounder)[0] == 0
    _, told, _ = typed("log", "export", "soundings", str(tmp_path), "--output", str(tmp_path / "soundings.csv"))
    assert re.search(": (5[0-9]|60) soundings", told), told


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("check", "/no/such/file"), "No such file"),
        (("check", VEHICLE, "--set", "runtime.window=3"), "runtime.window"),
        (("check", VEHICLE, "--set", "x="), "nothing after =; write a number"),
        (("sim", "--set", "log.directory='/log'", VEHICLE), "each simulation has its own; --output DIRECTORY"),
        (("check", VEHICLE, "--set", "nonsense"), "not KEY=VALUE"),
        (("drive", "--set", "console.socket='/no/such/socket'", VEHICLE, "stop"), "is it running"),
        (("run", VEHICLE, "--set", "services.nonsense.enabled=true"), "there is no such service"),
        (("drive", VEHICLE, "--set", "console.socket='/no/such/socket'", "heading", "90", "1.5"), "is it running"),
        (("drive", VEHICLE, "--sim", "state"), "no vehicle at run/sim/command"),
        (("fault", VEHICLE, "--sim", "end"), "no simulation answers at run/sim/nodes"),
        (("sim", VEHICLE, "--output", f"{VEHICLE}/nobody"), "nobody: Not a directory"),
        (("supervise", VEHICLE, "--set", f"runtime.run_directory='{VEHICLE}/nobody'"), "nobody: Not a directory"),
        (("console", "--no-browser", "--page", "127.0.0.1:65536"), "--page: 127.0.0.1:65536: not an address"),
    ],
)
def test_mistakes_are_one_line_on_standard_error(tmp_path, words, reason):
    process = delfim(*words, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)})
    out, err = process.communicate(timeout=200)
    assert process.returncode in (2, 100)
    assert reason in err
    assert err.count("\n") == 1
    assert not out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("log", "--help"), "replay"),
        (("can", "--help"), "candump"),
        (("sim", VEHICLE, "--for", "-3"), "--for: -3 is not a number of seconds above 0"),
        (("check", VEHICLE, "--fast"), "unrecognized arguments: --fast"),
    ],
)
def test_the_command_line_explains_itself(words, told):
    process = delfim(*words)
    out, err = process.communicate(timeout=200)
    assert told in out + err
    assert "Traceback" not in err


@pytest.mark.long
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
                if seen["computer"]:  # its process has come up
                    break
    guest.terminate()
    guest.communicate(timeout=200)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=200)
    assert modes, "grex was entered"
    assert modes[-1]["reference"]["heading_deg"] == pytest.approx(180.0), "course 150, 30 to starboard"
    assert set(modes[-1]["services"]) == {"cantcpd", "powerd", "vehicle"}, "the others are not in this process"
    assert seen["vehicle"]["mode"] == "grex"
    assert set(seen["services"]) >= {"vehicle", "httpd"}
    assert set(seen["computer"]["supervisor"]) == {"runtime", "syslogd", "canzlogd", "httpd"}
    assert list((tmp_path / "out").glob("log/*/*/*.log.gz")), "and works"


def test_a_scenario_leaves_its_log_and_its_track_where_it_is_told_to(tmp_path, typed):
    words = ("sim", VEHICLE, "--scenario", str(ROOT / "etc/scenarios/calm-mission.toml"))
    alone, kept = typed(*words)[1], typed(*words, "--output", str(tmp_path / "kept"))[1]
    events = [line for line in alone.splitlines() if re.match(r" *[0-9.]+ s  ", line)]
    assert events == [line for line in kept.splitlines() if re.match(r" *[0-9.]+ s  ", line)], "the same voyage"
    assert f"pictures     {tmp_path}/kept/track.png" in kept
    assert (tmp_path / "kept/track.png").stat().st_size > 10_000
    told = typed("log", "cat", "--events", str(tmp_path / "kept"))[1]
    assert re.search(r"  scenario +mission text .*done$", told, re.MULTILINE)
    assert re.search(r"  boat +mode play +operator$", told, re.MULTILINE)

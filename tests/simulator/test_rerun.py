"""A recorded run through the real loop once more: the same frames, bit by bit, or told where not."""

import gzip
import json
import re
from itertools import pairwise
from pathlib import Path

import pytest

from delfim.__main__ import main
from delfim.base.errors import DelfimError
from delfim.base.frames import Frame
from delfim.base.modes import Mode
from delfim.canproxy.socket import ANYTHING, CanAddress
from delfim.logging import blackbox
from delfim.logging.ashore.table import frames, table
from delfim.logging.blackbox import BlackBox
from delfim.logging.candump import format_line, parse_line
from delfim.logging.openlog import open_log
from delfim.logging.reading import read_log
from delfim.parts.dsor.driver import Propellers
from delfim.parts.nmea2000.combining import Nmea2000Source
from delfim.parts.nmea2000.source import Nmea2000Navigation
from delfim.simulator.lockstepbus import LockstepBus
from delfim.simulator.replay.rerun import rerun
from delfim.vehicle import console
from delfim.vehicle.grex import Guest
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.navigation.estimated import between
from delfim.vehicle.orders import voyage
from delfim.vehicle.orders.returning import RESTART
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.state import State
from tests.logging.sailing import MISSION, Day, logged, sailed


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("day")
    sailed(place).end()
    return place


def copied(day: Path, place: Path) -> Path:
    """The same logs, unpacked, to be tampered with; the folder of the day."""
    for file in logged(day):
        name = Path(file.path)
        target = place / name.parts[-3] / name.parts[-2] / name.name.removesuffix(".gz")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(read_log(file.path)[0])
        if file.sidecar:
            target.with_name(Path(file.sidecar).name).write_bytes(Path(file.sidecar).read_bytes())
    return next(place.iterdir())


def silent(day: Day, seconds: float) -> None:
    """The watchdog alone is called, at times of its own."""
    for _ in range(round(seconds / 0.1)):
        day.clock.advance(0.1003)
        day.sailing.vehicle.on_watchdog()
        day.log.watch(day.sailing.state)
        day.boxed()
    day.clock.advance(0.05)


def test_the_same_frames_bit_by_bit(day):
    result = rerun(logged(day), None)
    assert result.exact, result.text()
    assert result.cycles >= 320
    assert result.frames == sum(
        frame.arb >> 21 in range(0x40, 0x44) for _, frame in frames(each for each in logged(day) if each.id != "state")
    )
    assert "all the same, bit by bit" in result.text()


def test_a_program_held_up_between_its_two_clocks_is_repeated_in_its_order(day, tmp_path):
    """The wall clock of a command is reckoned from both clocks, which a busy machine reads some time apart."""
    folder, moved = copied(day, tmp_path), 0
    sidecar = folder / "state/000000.meta.jsonl"
    events = [json.loads(line) for line in sidecar.read_text().splitlines()]
    for event in events:
        if event["event"] == "command":
            event["monotonic_s"] += 0.25  # a cycle and more
            moved += 1
    sidecar.write_text("".join(json.dumps(event) + "\n" for event in events))
    assert moved > 0
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()


def test_other_gains_give_other_frames(day, tmp_path):
    folder = copied(day, tmp_path)
    sidecar = folder / "state/000000.meta.jsonl"
    sidecar.write_text(sidecar.read_text().replace('"p_nm_per_rad": null', '"p_nm_per_rad": 634.0'))
    result = rerun(logged(tmp_path), None)
    assert not result.exact
    assert len(result.differences) > 10
    assert re.search(r"recorded [0-9a-f ]+  repeated [0-9a-f ]+", result.text())


def test_one_frame_changed_on_disk_is_one_difference(day, tmp_path):
    folder = copied(day, tmp_path)
    box = folder / "lockstep/000000.log"
    lines = box.read_text().splitlines(keepends=True)
    at = max(i for i, line in enumerate(lines) if " 040#" in line)
    lines[at] = re.sub("#..", "#FF", lines[at])
    box.write_text("".join(lines))
    assert [each.recorded[:2] for each in rerun(logged(tmp_path), None).differences] == ["ff"]


def test_a_command_missing_in_the_black_box_is_told_and_the_rest_compared(day, tmp_path):
    folder = copied(day, tmp_path)
    box = folder / "lockstep/000000.log"
    lines = box.read_text().splitlines(keepends=True)
    sent = [i for i, line in enumerate(lines) if re.search(" 04[0-3]#", line)]
    box.write_text("".join(line for i, line in enumerate(lines) if i not in sent[400:404]))
    result = rerun(logged(tmp_path), None)
    assert [each.recorded for each in result.differences] == ["nothing"]


@pytest.mark.parametrize(
    ("log", "kept"), [("lockstep/000000.log", 0.8), ("lockstep/000000.log", 0.8002), ("state/000000.state", 0.8)]
)
def test_after_a_power_cut_what_both_logs_have_is_the_same(day, tmp_path, log, kept):
    folder = copied(day, tmp_path)
    content = (folder / log).read_bytes()
    (folder / log).write_bytes(content[: round(kept * len(content))])
    sidecar = folder / "state/000000.meta.jsonl"
    lines = sidecar.read_text().splitlines(keepends=True)
    sidecar.write_text("".join(line for line in lines if json.loads(line)["event"] != "end"))
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()
    assert 0.7 < result.frames / rerun(logged(day), None).frames < 0.85


def test_silence_of_navigation_and_what_the_watchdog_did_are_repeated(tmp_path):
    day = sailed(tmp_path)
    assert day.command(console.Heading(10.0, 1.0)) is None
    silent(day, 3.0)
    day.sail(5.0)
    day.end()
    assert "navigation silent" in json.dumps(
        [line for file in logged(tmp_path) for line in Path(file.sidecar).read_text().splitlines()]
    )
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()


def test_frames_that_are_stamped_long_after_their_look_are_repeated_as_they_were(tmp_path):
    """When the watchdog looked is known only where it noted something; all else it sent, and the black box stamped it later."""
    day = sailed(tmp_path / "day")
    assert day.command(console.Heading(10.0, 1.0)) is None
    day.sail(1.0)
    after_s, age_s = day.settings.failsafe.navigation_silent.after_s, day.clock.monotonic_s() - day.sailing.state.navigation_s
    day.clock.advance((after_s - 0.02 - age_s) % 0.1003)  # a look comes 20 ms before that is the trouble
    silent(day, 3.0)
    day.sail(2.0)
    day.end()
    box = copied(tmp_path / "day", tmp_path / "later") / "lockstep/000000.log"
    columns, _ = table([file for file in logged(tmp_path / "later") if file.id == "state"])
    t1 = columns["t1"]
    lines = list[str]()
    for line in box.read_text().splitlines(keepends=True):
        name, frame = parse_line(line)
        before = t1[t1 <= frame.t_ns]
        is_of_a_look = " 04" in line and len(before) and frame.t_ns - before[-1] > 400_000_000
        lines.append(format_line(frame._replace(t_ns=frame.t_ns + 45_000_000), name) if is_of_a_look else line)
    assert lines != box.read_text().splitlines(keepends=True)
    box.write_text("".join(lines))
    result = rerun(logged(tmp_path / "later"), None)
    assert result.exact, result.text()


@pytest.mark.parametrize("lasts_s", [1.0, 3.5])
def test_what_positions_that_were_refused_made_of_the_boat_is_repeated(tmp_path, lasts_s):
    """A refused position makes no cycle, and so no record."""
    day = sailed(tmp_path)
    assert day.command(console.Heading(10.0, 1.0)) is None
    day.sail(3.0)
    day.sailing.nodes.navigation.jump_m = 40.0
    day.sail(lasts_s)
    assert day.sailing.state.mode is Mode.IDLE
    day.sailing.nodes.navigation.jump_m = 0.0
    day.sail(5.0)
    assert day.command(console.Heading(10.0, 1.0)) is None
    day.sail(2.0)
    day.end()
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()


def test_a_node_that_repeats_itself_makes_no_cycles_and_the_run_is_repeated(tmp_path):
    day = sailed(tmp_path)
    assert day.command(console.Heading(10.0, 1.0)) is None
    for lasts_s in (0.5, 4.0):
        day.sailing.nodes.navigation.repeating = True
        day.sail(lasts_s)
        day.sailing.nodes.navigation.repeating = False
        day.sail(3.0)
    assert day.sailing.state.counts["navigation_repeated"] > 10
    assert day.sailing.state.mode is Mode.IDLE
    day.end()
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()


def test_what_was_said_before_the_boat_listened_is_not_its_input(tmp_path):
    """The black box is open a moment before the vehicle's sockets are."""
    day = Day(tmp_path)
    sailing = day.sailing
    for frame in sailing.nodes.step(day.clock.monotonic_s(), day.clock.time_ns()):
        sailing._world.send_many([frame])
    day.boxed()
    for source in sailing.vehicle.sources:
        assert source.read(day.clock.monotonic_s()) is not None
    day.clock.advance(0.2)
    day.sail(3.0)
    assert day.command(console.Heading(120.0, 1.5)) is None
    day.sail(10.0)
    day.end()
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()


def test_a_run_without_its_start_is_refused(day, tmp_path):
    folder = copied(day, tmp_path)
    (folder / "state/000000.meta.jsonl").write_text("")
    with pytest.raises(DelfimError, match="0 starts"):
        rerun(logged(tmp_path), None)


def test_a_state_log_alone_of_a_boat_that_hears_lines_is_refused(tmp_path, monkeypatch, capsys):
    """As lock step leaves it, or who copied this one: every command differed, and the boat seemed to be another one."""
    monkeypatch.chdir(tmp_path)
    assert main(["sim", "etc/boats/bait-boat.toml", "--lockstep", "--for", "5"]) == 0
    assert main(["log", "replay", "run/sim"]) == 2
    assert "what the boat heard is not beside this state log" in capsys.readouterr().err


def test_lines_come_back_as_they_were_written(day):
    box = [file for file in logged(day) if file.id != "state"]
    again = "".join(format_line(frame, name) for name, frame in frames(box))
    assert again == "".join(read_log(file.path)[0].decode() for file in box)


def test_a_guest_at_the_helm_is_repeated(tmp_path):
    """Its words lie in the records of the cycles that obeyed them; its silence makes a failsafe, at the same cycle as then."""
    day = Day(tmp_path, "failsafe.guest_silent.after_s=5.15")  # not between two looks of which but one is recorded
    day.sail(5.0)
    day.sailing.guest_says(b'{"heading_deg": 12.3456789, "speed_mps": 0.7}')
    assert day.command(console.SetMode("grex")) is None
    day.sail(1.0)
    for second in range(20):
        day.clock.advance(0.0003)
        day.sailing.guest_says(b'{"heading_deg": %d.25, "speed_mps": 1.1}' % (second * 17 % 360))
        day.sail(1.0)
    day.sail(20.0)  # it has gone silent
    day.end()
    columns, _ = table([file for file in logged(tmp_path) if file.id == "state"])
    assert len({value for value in columns["guest_heading"].tolist() if value == value}) >= 20
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()


RECORDING = Path(__file__).parents[1] / "data/nmea2000/raymarine-p70.candump.log.gz"


class Sensors:
    """A boat without simulation: its navigation is a recording of a real boat's NMEA 2000 bus, at its own times."""

    def __init__(self, place: Path, *more: str) -> None:
        overrides = ['navigation.sources=["nmea2000"]', "sysstat.required=[]", 'nmea2000.interface="canloop:n2k"', *more]
        self.day = Day(place, *overrides)
        settings, self.clock, self.log = self.day.settings, self.day.clock, self.day.log
        self.state = State()
        self.bus, wire = LockstepBus(self.clock, "n2k"), LockstepBus(self.clock, "lockstep")
        self.nodes, box = self.bus.socket("nodes"), self.bus.socket("box")
        own, propulsion = wire.socket("box"), wire.socket()
        for each in (box, own):
            each.bind(ANYTHING)
        decoder, sensors = Nmea2000Source(settings.nmea2000, settings.navigation.stale_s), self.bus.socket()
        sensors.bind(*(CanAddress(arb, mask) for arb, mask in decoder.filters))
        source = Nmea2000Navigation(sensors, decoder, self.state)
        self.source = between((source,), settings, self.state)[0] if settings.navigation.estimator else source
        guest = Guest(self.state, self.clock)
        outlet = Propulsion((Propellers(settings, propulsion),), propulsion, settings.thrusters, self.state)
        self.boat = VehicleLoop(settings, self.clock, self.state, (self.source,), outlet, guest, self.log)
        with pytest.MonkeyPatch.context() as patch:  # files of the clock of the recording need no child
            patch.setattr(blackbox, "open_log", lambda *words, **more: open_log(*words[:3], "zwrite", *words[4:], **more))
            self.box, self.ends = BlackBox([box, own], settings.log, self.clock), (box, own)

    def sail(self, frames: list[Frame]) -> None:
        watched_s = self.clock.monotonic_s()
        for before, frame in pairwise(frames):
            self.nodes.sendto(frame.data, CanAddress(frame.arb))
            self.clock.advance(0.00005)
            while self.boat.on_navigation(self.source):
                pass
            self.clock.advance(max(0.0, (frame.t_ns - before.t_ns) / 1e9 - 0.00005))
            if self.clock.monotonic_s() - watched_s > 0.1:
                watched_s = self.clock.monotonic_s()
                self.boat.on_watchdog()
                self.log.watch(self.state)
                self.clock.advance(0.00005)
            self.boxed()

    def command(self, command: console.Commands) -> None:
        refused = self.boat.on_command(command)
        self.log.command(command, refused, self.state)
        assert refused is None
        self.clock.advance(0.001)
        self.boxed()

    def boxed(self) -> None:
        for end in self.ends:
            self.box.on_readable(end)

    def end(self) -> None:
        self.boat.helm.stop("shutdown")
        self.boxed()
        self.log.close()
        self.box.close()


@pytest.mark.parametrize("more", [(), ("navigation.estimator=true", "navigation.rate_hz=20.0")], ids=["as it is", "estimated"])
def test_a_boat_with_nmea_2000_sensors_is_repeated(tmp_path, more):
    rows = gzip.decompress(RECORDING.read_bytes()).decode().splitlines()
    frames = [parse_line(row)[1] for row in rows if row.startswith("(")][:8000]
    boat = Sensors(tmp_path, *more)
    boat.sail(frames[:2000])
    boat.command(console.Heading(90.0, 1.0))
    boat.sail(frames[2000:5000])
    boat.command(console.Heading(271.5, 0.4))
    boat.sail(frames[5000:])
    boat.end()
    its = [file for file in logged(tmp_path) if file.id in ("state", "n2k", "lockstep")]
    result = rerun(its, None)
    assert result.exact, result.text()
    assert result.cycles > 100
    assert result.frames > 400


@pytest.mark.parametrize("late_s", [0.45, 0.62, 0.79])
def test_the_instant_at_which_a_position_is_too_old_is_repeated_however_late_the_sensors_begin(tmp_path, late_s):
    """Its age counts from the first frame, which need not come with the start."""
    rows = gzip.decompress(RECORDING.read_bytes()).decode().splitlines()
    frames = [parse_line(row)[1] for row in rows if row.startswith("(")]
    boat = Sensors(tmp_path, "navigation.estimator=true", "navigation.rate_hz=20.0")
    boat.clock.advance(late_s)
    boat.sail(frames[:800])
    boat.command(console.Heading(90.0, 1.0))
    boat.sail(frames[800:1200])
    positions = (129025, 129029)
    boat.sail([frame for frame in frames[1200:1600] if frame.arb >> 11 & 0x1FFFF not in positions])
    assert boat.state.mode is Mode.IDLE
    boat.sail(frames[1600:])
    boat.end()
    result = rerun([file for file in logged(tmp_path) if file.id in ("state", "n2k", "lockstep")], None)
    assert result.exact, result.text()


def test_a_voyage_that_goes_on_after_a_restart_is_repeated_bit_by_bit(tmp_path):
    before = Day(tmp_path / "before")
    before.sail(4.0)
    for command in (console.LoadMission(MISSION), console.Play()):
        assert before.command(command) is None
    before.sail(15.0)
    told = voyage.read(before.sailing.kept(), before.settings, voyage.KeptHead("DelfimX", "", "a boot", 0, 0.0))
    after = Day(tmp_path / "after")
    for command in (told.back, *told.sent):
        after.clock.advance(0.01)
        refused = after.sailing.vehicle.on_command(command, RESTART)
        after.log.command(command, refused, after.sailing.state, RESTART)
    after.sail(8.0)
    assert after.sailing.state.mode is Mode.HOLD
    assert after.command(console.Continue()) is None
    after.sail(8.0)
    after.end()
    result = rerun(logged(tmp_path / "after"), None)
    assert result.exact, result.text()
    assert result.frames > 100

"""A part that raises, lies, hangs or is slow costs itself, and is named: the boat sails on with what it has left."""

import math
import signal
from pathlib import Path

import pytest

from delfim import config
from delfim.base.errors import ConfigError, DelfimError, PermanentFailure
from delfim.canproxy.dsor.messages import Navigation
from delfim.parts.traffic.routeahead import route_ahead
from delfim.services.supervision.stop import PropellerStop
from delfim.simulator.line import LockstepLine
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.foreign import BROKEN_S, GuardedActuator, GuardedSensor, GuardedSource, breaking_off
from delfim.vehicle.navigation.fixes import Fix
from delfim.vehicle.state import Actuation, NoLog, State
from tests.parts.laboratory import ROOT, installed, laboratory

__all__ = ["laboratory"]
KINDS = ("motor", "source", "sensor", "trouble")
MOTORS = """thrusters=[{name="starboard", driver="example_motor", y_m=1.0, thrust_n=[-300.0, 500.0], rate_per_s=0.7}, \
{name="port", driver="dsor", address=1, y_m=-1.0, thrust_n=[-300.0, 500.0], rate_per_s=0.7}]"""
ABOARD = (
    *(f'parts.example_{kind}="1.0"' for kind in KINDS),
    'navigation.sources=["example_source", "dsor"]',
    'sensors.names=["sysstat", "example_sensor"]',
    MOTORS,
)


def boat(*more: str) -> Lockstep:
    return Lockstep(config.load(ROOT / "etc/delfimx.toml", (*ABOARD, *more)), 1, lambda clock: NoLog())


def sailing(run: Lockstep) -> Lockstep:
    for _ in run.cycles(5.0):
        pass
    assert run.command(console.Heading(90.0, 1.0)) is None
    for _ in run.cycles(10.0):
        pass
    return run


def edited(place: Path, file: str, before: str, after: str) -> None:
    text = (place / file).read_text()
    assert text.count(before) == 1
    (place / file).write_text(text.replace(before, after))


def test_the_examples_sail_the_boat_the_same_way_twice(laboratory):
    installed(laboratory, *KINDS)
    runs = [sailing(boat()) for _ in range(2)]
    model = runs[0].nodes.model
    assert (model.north_m, model.east_m) == (runs[1].nodes.model.north_m, runs[1].nodes.model.east_m)
    state = runs[0].state
    assert (state.mode.name, state.source) == ("HEADING", "example_source")
    assert model.east_m > 3.0
    assert state.measured["water_c"][0] == pytest.approx(18.0 + 0.01 * model.north_m, abs=0.02)
    assert [line for line in runs[0].lines["/dev/ttyUSB1"].written if b"thrust 0.000" not in line], "the motor was driven"
    assert next(each.reason for each in runs[0].vehicle.helm.checks() if each.name == "parts") == (
        "example_source, example_sensor, example_motor aboard"
    )
    assert all(not each.failed for each in state.parts.values())


def test_its_trouble_is_acted_on_as_the_table_says_and_is_a_bit_of_the_log(laboratory):
    installed(laboratory, *KINDS)
    run = sailing(boat("failsafe.few_satellites.satellites=20", 'failsafe.few_satellites.heading="hold"'))
    assert (run.state.mode.name, run.state.reason) == ("HOLD", "12 satellites")
    assert [(each.name, each.action) for each in run.state.notices] == [("few_satellites", "warn")]
    from delfim.vehicle.log import record

    columns = record.of(run.settings)
    told = dict(zip((each.name for each in columns.fields), record.values(columns, run.state, run.elapsed_s), strict=True))
    assert (told["troubles"], told["water_c"]) == (1 << 29, run.state.measured["water_c"][0])


@pytest.mark.parametrize(
    ("file", "before", "after", "words"),
    [
        ("example_sensor/sensor.py", "*lines, self._rest = (", "1 / 0\n        *lines, self._rest = (", "ZeroDivisionError"),
        ("example_sensor/sensor.py", "water_c, now_s", "float('nan'), now_s", "water_c is no finite number"),
        ("example_source/source.py", "fix = Fix(said", "fix = Fix(said._replace(heading_rad=float('inf'))", "not finite"),
        ("example_source/source.py", "fix = Fix(said, self.input.t_ns, now_s)", "fix = 'north'", "is no Fix"),
        ("example_source/source.py", "        fix = None", "        fix = self._lost", "no attribute '_lost'"),
        ("example_motor/driver.py", "sum(not self.input", "sum(not self._input", "no attribute '_input'"),
        (
            "example_motor/driver.py",
            "        return self.repeat(now_s)",
            "        self.repeat(now_s)",
            "send: TypeError: int()",
        ),
    ],
)
def test_what_raises_or_lies_is_switched_off_and_named(laboratory, file, before, after, words):
    installed(laboratory, *KINDS)
    edited(laboratory, file, before, after)
    run = boat()
    for _ in run.cycles(5.0):
        pass
    name = file.partition("/")[0]
    health = run.state.parts[name]
    assert health.failed == run.state.counts[f"{name}_failed"] == 3, "then it is not called any more"
    assert health.off.startswith(f"part {name} is switched off: ")
    assert words in health.off
    assert run.command(console.Heading(90.0, 1.0)) == f"heading refused: {health.off}", "no boat leaves with it"
    assert run.state.source == ("dsor" if name == "example_source" else "example_source")
    assert "water_c" not in run.state.measured or name != "example_sensor"


def test_under_way_a_boat_goes_on_without_what_was_switched_off(laboratory):
    installed(laboratory, *KINDS)
    run = sailing(boat())
    run.state.parts["example_sensor"].off = "part example_sensor is switched off: it is wet"
    assert run.command(console.Stop()) is None
    assert run.command(console.Heading(90.0, 1.0)) is None
    assert [each.reason for each in run.vehicle.helm.checks() if each.name == "parts"] == [
        run.state.parts["example_sensor"].off
    ]


def test_a_trouble_that_cannot_be_judged_is_there(laboratory):
    installed(laboratory, *KINDS)
    edited(laboratory, "example_trouble/sees.py", "    navigation, least", "    look.nothing\n    navigation, least")
    run = boat("failsafe.few_satellites.action='hold'")
    for _ in run.cycles(5.0):
        pass
    (notice,) = run.state.notices
    assert notice.name == "few_satellites"
    assert notice.reason.startswith("part example_trouble cannot tell: AttributeError: ")


class Hanging:
    """Everything that a part may be, and none of its calls returns."""

    name, input, inputs, period_s, heard_s = "hanging", LockstepLine, (), 0.2, 0.0
    caught = 0

    def hang(self, *_: object) -> None:
        while True:
            try:
                while True:
                    pass
            except TimeoutError:  # once even so
                self.caught += 1
                if self.caught % 2 == 0:
                    raise

    read = send = repeat = stop = disconnect = report = hang


def test_a_call_that_hangs_is_broken_off(monkeypatch):
    monkeypatch.setattr("delfim.vehicle.foreign.BROKEN_S", 0.01)
    monkeypatch.setattr("delfim.vehicle.foreign._limit", [breaking_off])
    state, hanging = State(), Hanging()
    source = GuardedSource(hanging, "hanging", state)
    for _ in range(5):
        assert source.read(0.0) is None
    assert state.parts["hanging"].failed == 3
    assert "it took more than" in state.parts["hanging"].off
    driver = GuardedActuator(hanging, 2, state)
    assert driver.send(Actuation((1.0,), (0.0,), True), 0.0) == 2, "commands that were not taken"
    with pytest.raises(OSError, match="part hanging: stop: "):
        driver.stop()
    assert BROKEN_S > 0.05, "a busy machine breaks nothing off"


def test_the_clock_never_strikes_outside_a_call():
    with breaking_off():
        pass
    signal.raise_signal(signal.SIGALRM)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    with pytest.raises(TimeoutError, match=r"it took more than 0\.1 s"), breaking_off():
        signal.raise_signal(signal.SIGALRM)
    signal.raise_signal(signal.SIGALRM)


def test_what_is_slow_is_counted(monkeypatch):
    times = iter((0.0, 0.003, 1.0, 1.0001))
    monkeypatch.setattr("delfim.vehicle.foreign.time.perf_counter", lambda: next(times))

    class Slow(Hanging):
        def read(self, *_: object) -> None:
            pass

    state = State()
    sensor = GuardedSensor(Slow(), "slow", state)
    for _ in range(2):
        sensor.read(state, 0.0)
    assert (state.parts["slow"].slow, state.parts["slow"].failed, state.parts["slow"].worst_s) == (1, 0, 0.003)


def test_numbers_that_are_not_finite_are_no_message():
    class Lying(Hanging):
        def read(self, *_: object) -> Fix:
            return Fix(Navigation, 0, math.nan)  # type: ignore[arg-type]

    state = State()
    assert GuardedSource(Lying(), "lying", state).read(0.0) is None
    assert state.parts["lying"].failed == 1


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        ("raise RuntimeError('made on a Friday')", "part example_motor: example_motor.driver cannot be imported: RuntimeError"),
        ("def open_actuator(settings, links):\n    while True: pass", "it took more than 0.1 s"),
        ("def open_actuator(settings, links):\n    return None", "AttributeError"),
    ],
)
def test_the_dead_man_stops_the_others_where_a_driver_is_broken(laboratory, tmp_path, caplog, broken, words):
    installed(laboratory, *KINDS)
    (laboratory / "example_motor/driver.py").write_text(broken)
    bus = f"canloop:parts-{tmp_path.name[-8:]}"
    settings = config.load(ROOT / "etc/delfimx.toml", (*ABOARD, f'can.interface="{bus}"'))
    stop = PropellerStop(settings)
    assert ("made on a Friday" in caplog.text) is ("Friday" in broken), "the log says at once what would not be stopped"
    from delfim.canproxy.dsor.messages import PROPELLER_PORT
    from delfim.canproxy.opening import open_can
    from delfim.canproxy.socket import CanAddress

    with open_can(bus) as ear:
        ear.bind(CanAddress(PROPELLER_PORT))
        ear.settimeout(200)
        with pytest.raises(DelfimError, match=words):
            stop()
        assert ear.recv(8)
    stop.close()


def test_a_boat_whose_driver_cannot_be_imported_does_not_start(laboratory):
    installed(laboratory, *KINDS)
    (laboratory / "example_motor/driver.py").write_text("raise RuntimeError('made on a Friday')")
    with pytest.raises(
        PermanentFailure, match=r"part example_motor: example_motor.driver cannot be imported: RuntimeError: made"
    ):
        boat()


def weaving(*more: str) -> Lockstep:
    settings = config.load(ROOT / "etc/delfimx.toml", ('parts.example_mode="1.0"', "example_mode.period_s=20.0", *more))
    run = Lockstep(settings, 1, lambda clock: NoLog())
    for _ in run.cycles(5.0):
        pass
    return run


def test_a_mode_of_a_laboratory_steers_and_is_answered_as_its_key_says(laboratory):
    installed(laboratory, "mode")
    run = weaving('failsafe.console_silent.weave="hold"', 'failsafe.console_silent.action="warn"')
    assert run.command(console.SetMode("weave")) is None
    headings = [state.reference.heading_rad or 0.0 for state in run.cycles(40.0)]
    assert math.degrees(max(headings) - min(headings)) == pytest.approx(40.0, abs=0.2), "20 degrees to either side"
    assert run.state.actuation.run
    run.faults.on["console_lost"] = 0.0
    for _ in run.cycles(20.0):
        pass
    assert (run.state.mode.name, run.state.reason[:19]) == ("HOLD", "console silent for ")


def test_a_mode_of_a_laboratory_is_named_wherever_modes_are(laboratory):
    installed(laboratory, "mode")
    run = weaving('traffic.guard.modes=["hold", "weave"]')
    assert run.settings.traffic.guard.modes == ("hold", "weave")
    assert run.command(console.SetMode("weave")) is None
    for _ in run.cycles(10.0):
        pass
    helm, state = run.vehicle.helm, run.state
    ahead = route_ahead(state.mode, helm.memory, state.setpoint, state.motion, helm.limits)
    assert (len(ahead.points), ahead.has_end) == (1, False), "it goes on as it does"
    with pytest.raises(ConfigError, match=r"traffic\.guard\.modes"):
        weaving('traffic.guard.modes=["weawe"]')


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (
            "heading_rad = (memory",
            "1 / 0\n        heading_rad = (memory",
            "part example_mode: step: ZeroDivisionError: division by",
        ),
        ("return after, Reference", "return Reference", "part example_mode: step returned no Memory, Reference and Wanted"),
        ("speed_mps), wanted", "speed_mps), Wanted(math.nan)", "set point makes no sense"),
        ("        return None", "        return self.nothing", "weave refused: part example_mode cannot tell: AttributeError"),
    ],
)
def test_a_mode_that_fails_stops_the_boat_and_is_named(laboratory, before, after, words):
    installed(laboratory, "mode")
    edited(laboratory, "example_mode/weave.py", before, after)
    run = weaving()
    refused = run.command(console.SetMode("weave")) or ""
    for _ in run.cycles(2.0):
        pass
    assert run.state.mode.name == "IDLE"
    assert not run.state.actuation.run
    assert words in (refused or run.state.reason)


@pytest.mark.parametrize(("name", "number"), [("hold", 120), ("weave", 5), ("weave", 119), ("weave", 140)])
def test_a_mode_has_a_number_and_a_name_of_its_own(laboratory, name, number):
    installed(laboratory, "mode")
    edited(laboratory, "example_mode/__init__.py", 'ModeRow("weave", 120,', f'ModeRow("{name}", {number},')
    with pytest.raises(ConfigError, match=rf"parts.example_mode: mode {name} cannot have the number {number}: 120 to 139"):
        weaving()

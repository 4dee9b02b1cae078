"""Trial mode: the pieces of a manoeuvre behind the gate, its bounds, and each end with its reason in words."""

import math
from pathlib import Path
from typing import Any

import msgspec
import pytest

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.model import Model, hull_of
from delfim.simulator.replay.rerun import rerun
from delfim.simulator.tables import SimulatedTraffic, SimulatedVessel
from delfim.vehicle import console
from delfim.vehicle.control.control import control
from delfim.vehicle.control.memory import Memory, settings_of
from delfim.vehicle.control.modes.trial import ended, enter
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.failsafe.checks import UNPROVEN
from delfim.vehicle.state import HANDSET, NOWHERE, Motion, NoLog, Setpoint, TrialPieces
from tests.logging.sailing import Day, logged

ROOT = Path(__file__).parents[2]
FILE = ROOT / "etc/delfimx.toml"
SETTINGS = settings_of(config.load(FILE))
ALL = frozenset({"position", "heading", "velocity"})
TRIAL = TrialPieces(1, ((2.0, (0.2, 0.0)), (1.0, (0.0, -0.1))), 10.0, 20.0, 30.0, math.radians(50.0))
PLACE = {"latitude_deg": 38.6907, "longitude_deg": -9.2153}


def at(north_m: float = 10.0, east_m: float = 20.0, **more: float) -> Motion:
    return NOWHERE._replace(has=ALL, north_m=north_m, east_m=east_m, **more)


def test_each_piece_lasts_its_time_and_then_it_is_done() -> None:
    setpoint, memory = Setpoint(trial=TRIAL), enter(at(), Setpoint(trial=TRIAL), SETTINGS)
    parts = list[Any]()
    for _ in range(40):
        memory, reference, wanted = control(Mode.TRIAL, memory, at(), setpoint, SETTINGS, 0.1)
        if reference.done:
            break
        parts.append(wanted.parts)
    assert parts == [(0.2, 0.0)] * 20 + [(0.0, -0.1)] * 10
    assert (reference.reason, wanted) == ("trial done", STOP)


@pytest.mark.parametrize(
    ("motion", "comes_back", "words"),
    [
        (at(), False, ""),
        (at(yaw_rate_radps=-0.9), False, "trial ended: turns at 52 deg/s, 50 are allowed"),
        (at(35.0, north_mps=1.9), False, ""),
        (at(35.0, north_mps=2.1), False, "trial ended: edge of the circle, 25 m from its middle"),
        (at(35.0, north_mps=2.1), True, ""),
        (at(42.0, north_mps=-0.1), False, ""),  # it is outside, and comes in
        (at(42.0, north_mps=0.1), False, "trial ended: edge of the circle, 32 m from its middle"),
        (at(48.0, north_mps=-0.1), True, "trial ended: 38 m from the middle of its circle of 30 m"),
    ],
)
def test_the_circle_and_the_rate_of_turn_bound_it(motion: Motion, comes_back: bool, words: str) -> None:
    trial = TRIAL._replace(comes_back=comes_back)
    assert ended(trial, motion) == words
    _, reference, wanted = control(Mode.TRIAL, Memory(leg=-1), motion, Setpoint(trial=trial), SETTINGS, 0.1)
    assert (reference.done, reference.reason, wanted.run) == (bool(words), words, not words)


def test_a_part_that_is_no_number_is_a_stop_at_the_gate() -> None:
    run = boat()
    assert ask(run, begin=True) is None
    trial = run.state.setpoint.trial
    assert trial is not None
    run.state.setpoint = run.state.setpoint._replace(trial=trial._replace(pieces=((5.0, (math.nan, 0.0)),)))
    run.cycle()
    assert run.state.actuation == run.vehicle.propulsion.still


def boat(proven: bool = True, **tables: Any) -> Lockstep:
    """DelfimX in idle, twelve seconds after its start, with motors that are proven or not."""
    settings = config.load(FILE, [f"adopted.proven={str(proven).lower()}"])
    settings = msgspec.structs.replace(settings, **tables)
    run = Lockstep(
        settings,
        1,
        lambda clock: NoLog(),
        Model(hull_of(settings), settings.simulation.sea, 1, *map(math.radians, PLACE.values()), 0.0, settings.thrusters),
    )
    list(run.cycles(12.0))
    return run


def ask(
    run: Lockstep, number: int = 1, parts: tuple[float, ...] = (0.3, -0.2), seconds: float = 5.0, **more: Any
) -> str | None:
    here = run.state.navigation
    assert here is not None
    assert here.latitude_rad is not None
    assert here.longitude_rad is not None
    place = {"latitude_deg": math.degrees(here.latitude_rad), "longitude_deg": math.degrees(here.longitude_rad)}
    told: dict[str, Any] = {"number": number, "pieces": ((seconds, parts),), **place, "radius_m": 30.0} | more
    return run.command(console.Try(**told))


def played(run: Lockstep, for_s: float, number: int = 1, **more: Any) -> None:
    """Go on asking for it."""
    for _ in run.cycles(for_s):
        if run.state.mode is Mode.TRIAL:
            assert ask(run, number, **more) is None


@pytest.mark.parametrize("proven", [True, False])
def test_a_manoeuvre_drives_each_thruster_behind_the_gate_and_ends_in_idle(proven: bool) -> None:
    run = boat(proven)
    assert ask(run, begin=True) is None
    assert (run.state.mode, run.state.armed) == (Mode.TRIAL, True)
    assert max(map(abs, run.state.actuation.thrust)) < 0.3, "the gate has its rate"
    played(run, 4.0)
    assert run.state.actuation.thrust == pytest.approx((0.3, -0.2))
    played(run, 2.0)
    assert (run.state.mode, run.state.reason, run.state.actuation.run) == (Mode.IDLE, "trial done", False)


def test_it_ends_when_nobody_asks_any_more_though_the_console_is_there() -> None:
    run = boat()
    assert ask(run, seconds=20.0, begin=True) is None
    list(run.cycles(1.5))
    assert run.state.mode is Mode.TRIAL
    list(run.cycles(0.8))
    assert run.state.mode is Mode.IDLE
    assert run.state.reason.startswith("trial ended: nobody asks for it for ")


def test_the_next_manoeuvre_replaces_it_and_none_goes_on_after_an_end() -> None:
    run = boat()
    assert ask(run) == f"trial refused: the boat is in mode idle: {run.state.reason}"
    assert ask(run, begin=True) is None
    list(run.cycles(1.0))
    assert ask(run, 2, (-0.1, 0.1)) is None
    list(run.cycles(1.5))
    assert run.state.actuation.thrust == pytest.approx((-0.1, 0.1))
    run.command(console.Stop())
    assert ask(run, 3) == "trial refused: the boat is in mode idle: operator"
    assert run.command(console.SetMode("trial")) == "trial refused: no manoeuvre: delfim adopt gives them"
    assert not run.state.actuation.run


def test_it_ends_for_a_kill_and_for_the_hand_set_and_is_no_pause() -> None:
    run = boat()
    assert ask(run, begin=True) is None
    run.command(console.Kill())
    assert run.state.mode is Mode.IDLE
    assert str(ask(run, begin=True)).startswith("trial refused: kill: ")
    run.command(console.Clear())
    assert ask(run, begin=True) is None
    assert run.command(console.Pause()) is None
    assert str(run.command(console.Continue())) == "continue refused: nothing is paused"
    assert ask(run, 5, begin=True) is None
    run.state.operator = HANDSET
    assert str(ask(run, 6)).startswith("refused: the hand-set has the boat")


def test_a_wrong_number_of_parts_or_too_long_a_piece_is_refused() -> None:
    run = boat()
    assert ask(run, parts=(0.1,), begin=True) == "trial refused: each piece has a part for each of 2 thrusters"
    for wrong in ('"pieces": [[31, [0.1, 0.1]]]', '"pieces": [[1, [1.1, 0.1]]]', '"pieces": []', '"radius_m": 201'):
        key = wrong.partition(":")[0]
        told = {
            '"number"': "1",
            '"pieces"': "[[1, [0, 0]]]",
            '"latitude_deg"': "38",
            '"longitude_deg"': "-9",
            '"radius_m"': "30",
        }
        told |= {key: wrong.partition(": ")[2]}
        line = "{" + ", ".join(f"{name}: {value}" for name, value in told.items()) + ', "command": "trial"}'
        with pytest.raises(FormatError, match="must be"):
            console.parse(line.encode())


@pytest.mark.parametrize(
    ("parts", "is_taken"), [((0.1,), False), ((0.1, 0.1), False), ((0.1, 0.1, 0.2), True), ((0.1,) * 4, False)]
)
def test_a_boat_with_a_motor_that_turns_is_told_a_part_for_its_angle_too(parts: tuple[float, ...], is_taken: bool) -> None:
    pushes, steer = (-60.0, 60.0), config.Steer(kind="azimuth", angle_max_deg=40.0, rate_dps=40.0)
    stern = config.ThrusterTable(name="stern", driver="pwm", address=2, x_m=-1.9, thrust_n=pushes, steer=steer)
    bow = config.ThrusterTable(name="bow", driver="pwm", address=1, x_m=1.5, angle_deg=90.0, thrust_n=pushes)
    run = boat(thrusters=(stern, bow))
    words = "trial refused: each piece has a part for each of 2 thrusters, and one for each of 1 that turn"
    assert (ask(run, parts=parts, begin=True) != words) is is_taken, "its propellers have not reported: that is asked later"


def test_a_vessel_on_its_way_into_the_circle_stops_it_and_one_that_passes_does_not() -> None:
    for aside_m, stops in ((0.0, True), (400.0, False)):
        ship = SimulatedVessel(
            name="MARIA", transponder="A", length_m=30.0, course_deg=270.0, speed_mps=2.0, north_m=aside_m, east_m=250.0
        )
        settings = config.load(FILE, ['sensors.names=["sysstat", "nmea2000"]'])
        world = msgspec.structs.replace(settings.simulation, traffic=SimulatedTraffic(vessel=(ship,)))
        run = Lockstep(msgspec.structs.replace(settings, simulation=world), 1, lambda clock: NoLog())
        list(run.cycles(12.0))
        assert run.state.traffic.targets
        assert ask(run, parts=(0.05, 0.05), seconds=30.0, begin=True) is None
        played(run, 5.0, parts=(0.05, 0.05), seconds=30.0)
        assert (run.state.mode is Mode.IDLE) is stops, run.state.reason
        if stops:
            assert run.state.reason.startswith("trial ended: 235000000 will come into the circle, in ")


def test_a_boat_whose_motors_are_not_proven_is_steered_by_no_failsafe() -> None:
    run = boat(proven=False)
    assert run.command(console.Heading(90.0, 1.0)) == f"heading refused: {UNPROVEN}"
    assert run.command(console.SetMode("hold")) == f"hold refused: {UNPROVEN}"
    assert [each.reason for each in run.vehicle.helm.checks() if each.name == "adopted"] == [UNPROVEN]
    assert run.command(console.Manual(0.1, 0.1)) is None
    assert run.command(console.Pause()) is None
    assert run.state.mode is Mode.IDLE
    actions = run.vehicle.helm.rules.actions.values()
    assert {each.name for row in actions for each in row.values()} == {"WARN", "STOP", "DISCONNECT"}


@pytest.mark.parametrize("trouble", ["console_silent", "battery_low", "fence", "shallow", "ais_silent"])
def test_its_actions_are_those_of_its_file_where_they_do_not_steer(trouble: str) -> None:
    proven, unproven = (boat(each).vehicle.helm.rules for each in (True, False))
    (trigger,) = [each for each in proven.names if proven.names[each] == trouble]
    for mode in Mode:
        was, now = proven.actions[trigger][mode], unproven.actions[trigger][mode]
        assert now.name == ("STOP" if was.name in ("HOLD", "BACK", "HOME") else was.name)


def test_the_log_says_it_and_a_replay_repeats_it(tmp_path: Path) -> None:
    day = Day(tmp_path)
    day.sail(12.0)
    for number, parts in ((1, (0.3, 0.0)), (1, (0.3, 0.0)), (2, (0.0, -0.3)), (3, (0.1, 0.1))):
        told = {"latitude_deg": 38.6907, "longitude_deg": -9.2153, "radius_m": 200.0, "name": "turn"}
        assert day.command(console.Try(number, ((3.0, parts),), **told, begin=True)) is None
        day.sail(1.0)
    day.sail(4.0)
    assert day.sailing.state.reason.startswith(("trial done", "trial ended: nobody asks"))
    day.end()
    said = [line for file in logged(tmp_path) if file.id == "state" for line in Path(file.sidecar).read_text().splitlines()]
    assert sum('"command":"trial"' in line for line in said) == 4
    assert [line for line in said if '"trial done"' in line or "trial ended: nobody asks" in line]
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()

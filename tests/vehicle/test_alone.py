"""One thruster by itself in idle: while it is asked for, behind the gate, and never in another mode."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import pytest

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.modes import Mode
from delfim.simulator.faults import fault
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.replay.rerun import rerun
from delfim.vehicle import console
from delfim.vehicle.helm.alone import KEPT_S
from delfim.vehicle.state import HANDSET, NoLog
from tests.logging.sailing import Day, logged
from tests.parts.pwm.test_pulsefiles import rows

GPS = config.Sysstat(required=("gps",))
TRY = console.Actuate("port", 0.2, 10.0)
DRIVERS = ["dsor", "dronecan", "vesc", "pwm"]


def boat(driver: str = "dsor") -> Lockstep:
    """A boat in idle for five seconds, with a navigation message each tenth of one."""
    thrusters = config.DELFIMX if driver == "dsor" else rows(driver)
    navigation = config.NavigationTable(rate_hz=10.0)
    settings = config.Vehicle(boat=config.BoatTable(name="test"), thrusters=thrusters, sysstat=GPS, navigation=navigation)
    run = Lockstep(settings, 1, lambda clock: NoLog())
    list(run.cycles(5.0))
    return run


def asked(run: Lockstep, seconds: float, command: console.Actuate = TRY) -> list[tuple[float, ...]]:
    """What was sent while this is asked for again and again."""
    sent = list[tuple[float, ...]]()
    for state in run.cycles(seconds):
        assert run.command(command) is None
        sent.append(state.actuation.thrust)
    return sent


def parts(run: Lockstep) -> list[float]:
    return [round(drive.part, 2) for drive in run.nodes.model.drives.values()]


@pytest.mark.parametrize("driver", DRIVERS)
def test_it_turns_alone_no_faster_than_the_gate_lets_it(driver: str) -> None:
    run = boat(driver)
    sent = asked(run, 3.0)
    steps = [after[1] - before[1] for before, after in itertools.pairwise(sent)]
    assert 0.0 < max(steps) <= 0.1 * run.settings.thrusters[1].rate_per_s + 1e-9
    assert sent[-1] == (0.0, 0.2)
    assert run.state.mode is Mode.IDLE
    assert (run.state.actuation.run, run.state.armed, run.state.reason) == (True, False, "operator tries port alone at 20%")
    assert parts(run) == pytest.approx([0.0, 0.2], abs=0.03)
    assert not [each for each in run.state.notices if each.name == "thruster"]


@pytest.mark.parametrize("driver", DRIVERS)
def test_it_stops_when_nobody_asks_any_more(driver: str) -> None:
    run = boat(driver)
    asked(run, 3.0)
    list(run.cycles(KEPT_S - 0.1))
    assert run.state.actuation.run
    list(run.cycles(0.3))
    assert run.state.actuation == run.vehicle.propulsion.still
    assert run.state.reason == "port tried: nobody asks for it any more"
    list(run.cycles(5.0))
    assert parts(run) == pytest.approx([0.0, 0.0], abs=0.02)
    assert asked(run, 2.0)[-1] == (0.0, 0.2), "and again"


def test_it_ends_in_time_and_does_not_begin_again_before_the_key_was_let_go() -> None:
    run = boat()
    asked(run, 1.9, two_s := console.Actuate("port", 0.2, 2.0))
    list(run.cycles(0.2))
    assert run.state.actuation == run.vehicle.propulsion.still
    for _ in run.cycles(3.0):
        assert run.command(two_s) == "actuate refused: port tried: its time is over; let go for 0.8 s"
        assert not run.state.actuation.run
    list(run.cycles(1.0))
    asked(run, 1.0)


def test_another_thruster_needs_a_pause_and_no_thrust_ends_it_at_once() -> None:
    run = boat()
    asked(run, 1.0)
    assert "let go for 0.8 s" in str(run.command(console.Actuate("starboard", 0.1)))
    assert run.command(console.Actuate("port", 0.0)) is None
    assert run.state.actuation == run.vehicle.propulsion.still
    assert run.state.reason == "port tried: operator ended it"
    run.state.operator = "console 7"
    assert run.command(console.Actuate("port", 0.0)) == "actuate refused: no thruster is tried"
    assert run.state.operator == "console 7", "who ends nothing does not take the boat"


ENDS = [console.Stop(), console.Kill(), console.SetMode("idle"), console.Leave(), console.ShutDown()]


@pytest.mark.parametrize("command", ENDS, ids=lambda command: type(command).__name__)
def test_a_stop_is_a_stop(command: console.Commands) -> None:
    run = boat()
    asked(run, 2.0)
    assert run.command(command) is None
    assert run.state.actuation == run.vehicle.propulsion.still
    for state in run.cycles(3.0):
        assert state.actuation == run.vehicle.propulsion.still


def test_a_mode_ends_it_and_thrust_by_hand_goes_to_both_sides_again() -> None:
    run = boat()
    asked(run, 2.0)
    for _ in run.cycles(3.0):
        assert run.command(console.Manual(starboard=0.4, port=0.3)) is None
    assert run.state.mode is Mode.MANUAL
    assert run.state.actuation.thrust == pytest.approx((0.4, 0.3))


MODES = [console.Manual(0.1, 0.1), console.Heading(90.0, 1.0), console.SetMode("hold")]


@pytest.mark.parametrize("command", MODES, ids=lambda command: type(command).__name__)
def test_in_any_other_mode_it_is_refused_and_nothing_changes(command: console.Commands) -> None:
    run = boat()
    assert run.command(command) is None
    mode = run.state.mode
    list(run.cycles(0.3))
    assert run.command(TRY) == f"actuate refused: the boat is in mode {mode.name.lower()}; stop it first"
    assert run.state.mode is mode
    assert not run.state.setpoint.alone


def test_killed_or_in_the_hand_of_the_hand_set_or_unknown_it_is_refused() -> None:
    run = boat()
    assert run.command(console.Actuate("prot", 0.1)) == "actuate refused: there is no thruster 'prot'; did you mean port?"
    run.command(console.Kill())
    assert str(run.command(TRY)).startswith("actuate refused: kill: ")
    run.command(console.Clear())
    run.state.operator = HANDSET
    assert str(run.command(TRY)).startswith("refused: the hand-set has the boat")
    assert not run.state.actuation.run


@pytest.mark.parametrize("words", ['"part": 0.31', '"part": -0.5', '"part": 0.1, "for_s": 61', '"part": 0.1, "for_s": 0'])
def test_more_than_a_bench_needs_is_not_understood(words: str) -> None:
    with pytest.raises(FormatError, match="must be"):
        console.parse(b'{"command": "actuate", "thruster": "port", %s}' % words.encode())


@pytest.mark.parametrize("driver", DRIVERS)
def test_it_needs_no_navigation(driver: str) -> None:
    run = boat(driver)
    run.breaks(fault("navigation_silent"))
    list(run.cycles(3.0))
    assert asked(run, 3.0)[-1] == (0.0, 0.2)
    assert parts(run) == pytest.approx([0.0, 0.2], abs=0.03)
    list(run.cycles(4.0))
    assert run.state.actuation == run.vehicle.propulsion.still
    assert parts(run) == pytest.approx([0.0, 0.0], abs=0.02)


def said(place: Path) -> Sequence[str]:
    return [line for file in logged(place) if file.id == "state" for line in Path(file.sidecar).read_text().splitlines()]


@pytest.mark.parametrize("driver", ["dsor", "vesc"])
def test_the_log_says_it_and_a_replay_repeats_it(driver: str, tmp_path: Path) -> None:
    motors = [
        f'{{name="{row.name}", driver="vesc", address={row.address}, y_m={row.y_m}, thrust_n=[-9.0, 9.0], rpm_max=900.0}}'
        for row in config.DELFIMX
    ]
    day = Day(tmp_path, 'sysstat.required=["gps"]', *([f"thrusters=[{', '.join(motors)}]"] if driver == "vesc" else []))
    day.sail(5.0)
    for _ in range(8):
        assert day.command(console.Actuate("port", -0.15, 5.0)) is None
        day.sail(0.2)
    assert day.sailing.state.actuation.thrust == (0.0, -0.15)
    day.sail(5.0)
    day.end()
    assert [line for line in said(tmp_path) if "operator tries port alone at -15%" in line]
    assert [line for line in said(tmp_path) if "port tried: nobody asks for it any more" in line]
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()

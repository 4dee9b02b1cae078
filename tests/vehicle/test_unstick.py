"""Unstick: astern out of weeds by the way it came, bounded in time and place; what comes then; and who cannot."""

import math
from pathlib import Path

import pytest

from delfim import config
from delfim.base.errors import ConfigError
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.control.control import settings_of
from delfim.vehicle.control.modes import unstick
from delfim.vehicle.state import Motion, NoLog, Setpoint

ROOT = Path(__file__).parents[2]
ALL = frozenset({"position", "heading", "velocity"})
TRACK = ((0.0, 0.0), (0.0, 5.0), (0.0, 10.0), (0.0, 15.0))  # to the east
AHEAD_ONLY = tuple(
    config.ThrusterTable(name=row.name, driver="pwm", address=row.address, x_m=-2.0, y_m=row.y_m, thrust_n=(0.0, 500.0))
    for row in config.DELFIMX
)


def vehicle(then: str = "hold", action: str = "unstick", **more: object) -> config.Vehicle:
    return config.Vehicle(
        boat=config.BoatTable(name="test"),
        control=config.ControlTable(unstick=config.UnstickTable(then=then)),  # type: ignore[arg-type]
        failsafe=config.Failsafe(pause_s=5.0, stuck=config.Stuck(action=action)),  # type: ignore[arg-type]
        sysstat=config.Sysstat(required=()),
        **more,  # type: ignore[arg-type]
    )


SETTINGS = settings_of(vehicle())


def motion(east_m: float = 16.0, heading_deg: float = 90.0, north_m: float = 0.0) -> Motion:
    return Motion(ALL, north_m, east_m, math.radians(heading_deg), 0.0, 0.0, 0.0)


def stepped(here: Motion, track: tuple[tuple[float, float], ...] = TRACK, after_s: float = 0.2, began: Motion | None = None):
    setpoint = Setpoint(track=track)
    memory = unstick.enter(began or here, setpoint, SETTINGS)
    return unstick.step(memory, here, setpoint, SETTINGS, after_s)


@pytest.mark.parametrize(
    ("heading_deg", "track", "steers_deg", "is_ahead"),
    [
        (90.0, TRACK, 90.0, False),
        (50.0, TRACK, 90.0, False),
        (-70.0, TRACK, -90.0, True),  # it was turned round: the way lies ahead
        (200.0, TRACK, 90.0, False),  # and here abeam
        (200.0, (), 200.0, False),
        (200.0, TRACK[-1:], 200.0, False),  # too near to steer for
    ],
)
def test_the_stern_points_at_the_driven_track(heading_deg, track, steers_deg, is_ahead) -> None:
    memory, reference, wanted = stepped(motion(heading_deg=heading_deg), track)
    assert math.degrees(reference.heading_rad) % 360.0 == pytest.approx(steers_deg % 360.0)
    assert reference.speed_mps == (1.0 if is_ahead else -1.0)
    assert not reference.done
    assert wanted.surge_n <= 0.0 or is_ahead
    assert memory.left_s == pytest.approx(44.8)


def test_it_goes_from_point_to_point_of_the_track() -> None:
    bent = ((-20.0, 5.0), (-15.0, 5.0), (-10.0, 5.0), (-5.0, 5.0), (0.0, 5.0), (0.0, 10.0))
    assert (stepped(motion(16.0), bent)[1].north_m, stepped(motion(16.0), bent)[1].east_m) == (0.0, 10.0)
    reference = stepped(motion(6.0, north_m=-1.0), bent)[1]
    assert (reference.north_m, reference.east_m) == (0.0, 10.0) or reference.north_m == -10.0
    memory = unstick.enter(motion(16.0), Setpoint(track=bent), SETTINGS)
    memory, *_ = unstick.step(memory, motion(9.0), Setpoint(track=bent), SETTINGS, 0.2)
    assert memory.leg < 5, "the point is reached"


@pytest.mark.parametrize(
    ("east_m", "after_s", "words", "left_m"),
    [
        (1.1, 0.2, "", 0.1),
        (1.0, 0.2, "15 m away", 0.0),
        (31.0, 0.2, "15 m away", 0.0),  # wherever the current carries it
        (14.0, 44.9, "", 13.0),
        (14.0, 45.0, "still stuck after 45 s", 13.0),
    ],
)
def test_it_ends_so_far_away_or_after_so_long(east_m, after_s, words, left_m) -> None:
    _, reference, wanted = stepped(motion(east_m), after_s=after_s, began=motion())
    assert (reference.done, reference.reason) == (bool(words), words)
    assert reference.distance_m == pytest.approx(left_m)
    assert wanted.run is not bool(words)


def caught(file: config.Vehicle, weeds_s: float = 5.0, order: console.Command | None = None) -> Lockstep:
    """Under way to the east for a minute, and then in weeds."""
    run = Lockstep(file, 1, lambda clock: NoLog())
    for _ in run.cycles(3.0):
        pass
    assert run.command(console.Heading(90.0, 1.5)) is None
    for _ in run.cycles(60.0):
        pass
    if order is not None:
        assert run.command(order) is None
        for _ in run.cycles(30.0):
            pass
    run.nodes.model.weeds_s = weeds_s
    return run


def sailed(run: Lockstep, seconds: float) -> list[tuple[Mode, str]]:
    """The modes that it entered, with their reasons."""
    seen: list[tuple[Mode, str]] = []
    for _ in run.cycles(seconds):
        if not seen or seen[-1] != (run.state.mode, run.state.reason):
            seen.append((run.state.mode, run.state.reason))
        run.command(console.Alive())
    return seen


@pytest.mark.parametrize("then", ["hold", "home"])
def test_a_stuck_boat_frees_itself_and_does_what_its_file_says(then) -> None:
    run = caught(vehicle(then))
    east_m = run.nodes.model.east_m
    modes = sailed(run, 60.0)
    assert [mode for mode, _ in modes][:3] == [Mode.HEADING, Mode.UNSTICK, Mode[then.upper()]]
    assert modes[2][1].startswith("unstick done: 1")
    assert run.nodes.model.east_m < east_m - 8.0
    assert abs(run.nodes.model.north_m) < 5.0


def test_one_that_stays_stuck_gives_up_holds_and_does_not_try_again_there() -> None:
    run = caught(vehicle("home"), weeds_s=1e9)
    modes = sailed(run, 90.0)
    assert modes[-1] == (Mode.HOLD, "unstick done: still stuck after 45 s")
    assert run.command(console.Heading(90.0, 1.5)) is None
    *_, last = sailed(run, 40.0)
    assert last[0] is Mode.HOLD
    assert last[1].endswith("; it went astern here before")


def test_one_that_was_on_its_way_home_goes_on_home() -> None:
    run = caught(vehicle(), order=console.SetMode("home"))
    assert [mode for mode, _ in sailed(run, 60.0)] == [Mode.HOME, Mode.UNSTICK, Mode.HOME]


def test_the_mode_that_was_interrupted_goes_on_when_the_operator_says_so() -> None:
    run = caught(vehicle())
    sailed(run, 60.0)
    assert run.state.mode is Mode.HOLD
    assert run.vehicle.report().paused == "heading"
    assert run.command(console.Continue()) is None
    assert run.state.mode is Mode.HEADING


def test_the_operator_orders_it_again_and_again_and_ends_it() -> None:
    run = caught(vehicle(action="hold"), weeds_s=1e9)
    for _ in range(2):
        assert run.command(console.SetMode("unstick")) is None
        assert [mode for mode, _ in sailed(run, 50.0)] == [Mode.UNSTICK, Mode.HOLD]
    assert run.command(console.SetMode("unstick")) is None
    assert run.command(console.Stop()) is None
    assert run.state.mode is Mode.IDLE


def test_the_fence_goes_before() -> None:
    run = caught(vehicle(), weeds_s=0.5)
    model, place = run.nodes.model, run.settings.simulation
    north_deg = math.degrees((model.east_m - 25.0) / 6.37e6 / math.cos(math.radians(place.latitude_deg)))
    wall = config.Area(centre=((place.latitude_deg, place.longitude_deg + north_deg),), radius_m=12.0)
    assert run.command(console.SetFence(config.Zones(keep_out=(wall,)))) is None
    modes = sailed(run, 60.0)
    assert [mode for mode, _ in modes] == [Mode.HEADING, Mode.UNSTICK, Mode.HOLD]
    assert "zone" in modes[-1][1]


def test_a_boat_whose_thrusters_push_ahead_alone_cannot() -> None:
    run = Lockstep(vehicle(thrusters=AHEAD_ONLY), 1, lambda clock: NoLog())
    why = "it cannot go astern: its thrusters push ahead alone"
    assert run.vehicle.helm.limits.hull.astern_n == 0.0
    for _ in run.cycles(3.0):
        pass
    assert why in (run.command(console.SetMode("unstick")) or "")


@pytest.mark.parametrize("asked", ['failsafe.stuck.action="unstick"', "control.unstick.time_s=30.0"])
def test_a_file_that_asks_it_of_a_boat_that_only_pushes_ahead_is_refused(asked: str) -> None:
    told = ((row.name, row.address, row.y_m) for row in AHEAD_ONLY)
    rows = [f'{{name="{name}",driver="pwm",address={at},thrust_n=[0.0,500.0],y_m={y_m}}}' for name, at, y_m in told]
    key = asked.partition("=")[0].removesuffix(".time_s")
    with pytest.raises(ConfigError, match=f"{key}: the boat cannot go astern"):
        config.load(ROOT / "etc/delfimx.toml", [f"thrusters=[{','.join(rows)}]", asked])

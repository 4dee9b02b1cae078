"""A receiver of AIS that goes wrong, and too many vessels: through a boat in lock step and its link, to console and page."""

import functools
import math
import re
from pathlib import Path
from typing import Any

import pytest

from delfim import config
from delfim.base.geodesy import origin, to_plane
from delfim.base.modes import Mode
from delfim.console.boats.fleet import Fleet
from delfim.console.boats.othervessels import around
from delfim.parts.mavlink.station import Station
from delfim.simulator.faults import fault
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.state import NoLog
from tests.console.standin import Standin
from tests.kit.page import shown
from tests.services.browser import Page

ROOT = Path(__file__).parents[2]
CONSOLE = ("127.0.0.1", 14550)
GOES_WRONG_S = 30.0
MARIA = '{name="MARIA", transponder="A", length_m=30.0, beam_m=6.0, north_m=900.0, east_m=300.0, course_deg=180.0, speed_mps=2}'
OURSELVES = '{name="DELFIM", transponder="B", course_deg=0.0, speed_mps=1.5}'
CROWD = ",".join(
    f'{{name="V{i}", transponder="A", north_m={300 * (i // 20) + 900}, east_m={300 * (i % 20) - 2850}, '
    f"course_deg={i % 360}, speed_mps=1.0}}"
    for i in range(220)
)
SEAS = {"ais_silent": MARIA, "ais_frozen": MARIA, "ais_late": MARIA, "on us": f"{MARIA},{OURSELVES}", "many": CROWD}
PAGE_SAYS = {
    "ais_silent": "/^AIS: 1 target, last report (3 min|1[89][0-9] s) ago/",
    "ais_frozen": "/^AIS: 1 target, last report [0-9] s ago/",
    "ais_late": "/^AIS: 1 target, last report [0-9] s ago/",
    "on us": "/^AIS: 2 targets.*DELFIM/",
    "many": "/^AIS: 200 targets/",
}


class Chain:
    """A boat that sails a course, its station, and the console's fleet; one clock."""

    def __init__(self, vessels: str) -> None:
        more = ['sensors.names=["sysstat", "nmea2000"]', "simulation.heading_deg=0.0"]
        more += ['simulation.traffic.heard="perfect"'] if vessels is not CROWD else []  # nobody hears 220 a second
        more += [f'mavlink.peers=["{CONSOLE[0]}:{CONSOLE[1]}"]', f"simulation.traffic.vessel=[{vessels}]"]
        self.boat = Lockstep(config.load(ROOT / "etc/delfimx.toml", more), 1, lambda clock: NoLog())
        self.told: list[dict[str, Any]] = []
        self.fleet = Fleet(self.boat.clock, lambda _, data: self.station.receive(data, CONSOLE), self.told.append)
        self.station = Station(
            self.boat.vehicle, self.boat.vehicle.on_command, lambda data, _: self.fleet.receive(1, data), None
        )

    def sail(self, seconds: float) -> None:
        for _ in self.boat.cycles(seconds):
            while self.station.turn():
                pass
            self.station.tick()
            self.fleet.tick()

    def shown(self) -> dict[str, Any]:
        return around(list(self.fleet.boats.values()), self.boat.clock.monotonic_s())


@functools.cache
def sailed(trouble: str) -> Chain:
    chain = Chain(SEAS[trouble])
    chain.sail(6.0)
    assert chain.boat.command(console.Course(course_deg=0.0, speed_mps=1.5)) is None
    chain.sail(GOES_WRONG_S - 6.0)
    if trouble.startswith("ais_"):
        chain.boat.breaks(fault(trouble))
    chain.sail(190.0 if trouble == "ais_silent" else 75.0)
    return chain


def north_m(vessel: dict[str, Any]) -> float:
    """From where the simulation begins."""
    start = origin(math.radians(38.6907), math.radians(-9.2153))
    return to_plane(start, math.radians(vessel["latitude_deg"]), math.radians(vessel["longitude_deg"]))[0]


@pytest.mark.parametrize("trouble", SEAS)
def test_the_boat_sails_on_and_the_console_shows_what_it_knows(trouble: str) -> None:
    chain = sailed(trouble)
    state, seen, now_s = chain.boat.state, chain.shown(), chain.boat.elapsed_s
    assert state.mode is Mode.COURSE, "other vessels warn"
    assert state.traffic.guard == "on"
    missing = {each.key for each in state.traffic.targets} - {each["key"] for each in seen["vessels"]}
    assert len(missing) <= (5 if trouble == "many" else 0), "of 220 vessels 200 are known, and who they are changes"
    vessels = {each["name"]: each for each in seen["vessels"]}
    notices = {each.name: each.reason for each in state.notices}
    match trouble:
        case "ais_silent":
            assert re.fullmatch("AIS silent for 19[01] s: other vessels are not seen", notices["ais_silent"])
            assert (vessels["MARIA"]["lost"], seen["heard_s"] > 180.0) == (True, True)
        case "ais_frozen":  # no receiver says so, and no boat can know
            assert vessels["MARIA"]["age_s"] < 5.0
            assert north_m(vessels["MARIA"]) == pytest.approx(900.0 - 2.0 * GOES_WRONG_S, abs=10.0)
        case "ais_late":
            assert north_m(vessels["MARIA"]) == pytest.approx(900.0 - 2.0 * (now_s - 60.0), abs=10.0)
        case "on us":
            assert notices["traffic_close"].startswith("DELFIM is close")
            assert vessels["DELFIM"]["boats"][0]["danger"] != "none"
        case "many":
            assert len(state.traffic.targets) == len(seen["vessels"]) == 200
            assert not any(each["lost"] for each in seen["vessels"]), "the boat hears them"


@pytest.fixture(scope="module")
def seas() -> list[dict[str, Any]]:
    """Sailed before there is a page: it hears nothing meanwhile, and gives its gateway up."""
    return [sailed(trouble).shown() for trouble in PAGE_SAYS]


async def test_the_page_shows_it_too(seas: list[dict[str, Any]], page: Page, gateway: Standin) -> None:
    for seen, said in zip(seas, PAGE_SAYS.values(), strict=True):
        gateway.vessels, gateway.reported_s = seen["vessels"], seen["heard_s"]
        for each in gateway.vessels:
            each["boats"] = [near | {"boat": 1} for near in each["boats"]]
        await gateway.look()
        await shown(page, gateway, f"delfim.vessels().length === {len(seen['vessels'])}")
        await shown(page, gateway, f"{said}.test(document.querySelector('#traffic').textContent)")

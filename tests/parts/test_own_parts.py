"""The boat's own parts keep the contract of a laboratory's: lines where nobody makes sense, or that take nothing, and stop."""

import pytest

from delfim import config
from delfim.base.parts import OWN, Part
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.parts.torqeedo.table import TorqeedoPort, TorqeedoTable, TorqlinkPort, TorqlinkTable
from delfim.simulator.contract import devices, judged

DRIVERS = tuple(row for row in OWN.values() if row.driver)
INPUTS = tuple(row for row in OWN.values() if row.source or row.sensor)
BOARD = {  # it obeys and speaks only after its first heartbeat, which nobody says here
    "commands are sent": "send or repeat returned 2, not 0",
    "source: what its device says byte by byte": "it was not understood",
    "source: what its device says many times at once": "it was not understood",
    "source: what its device says frozen": "it was not understood",
}
NOT_READY = {"commands are sent": "send or repeat returned 2, not 0"}  # it obeys once it said that it is ready
KNOWN = {"mavlink_front_seat": BOARD, "torqlink": NOT_READY}


def boat(row: Part) -> config.Vehicle:
    """A boat with two thrusters of a driver, and nothing but the part's own source and sensor."""
    thrusters = tuple(
        config.ThrusterTable(
            name=name,
            driver=row.name if row.driver else "dsor",
            address=at,
            y_m=0.5 - at,
            thrust_n=(-50.0, 50.0),
            rpm_max=1500.0,
        )
        for at, name in enumerate(("starboard", "port"))
    )
    return config.Vehicle(
        boat=config.BoatTable(name="test"),
        thrusters=thrusters,
        navigation=config.NavigationTable(sources=(row.name if row.source else "dsor",)),
        sensors=config.Sensors(names=tuple({"sysstat": 1, row.name if row.sensor else "sysstat": 1})),
        nmea0183=Nmea0183(ports={"gnss": Nmea0183Port(device="/dev/gnss")}),
        torqeedo=TorqeedoTable(ports={name: TorqeedoPort(device=f"/dev/{name}") for name in ("starboard", "port")}),
        torqlink=TorqlinkTable(ports={name: TorqlinkPort(interface=f"canloop:{name}") for name in ("starboard", "port")}),
    )


@pytest.mark.parametrize("row", [*DRIVERS, *(row for row in INPUTS if not row.driver)], ids=lambda row: row.name)
def test_a_part_of_the_boats_own_keeps_the_contract(row: Part) -> None:
    faults = {each.what: each.fault for each in devices(row, boat(row)) if each.fault}
    assert faults == KNOWN.get(row.name, {})


def test_a_call_that_a_busy_machine_held_up_is_no_fault_and_one_that_is_long_each_time_is() -> None:
    tries = iter([[0.05, 0.001], [0.001, 0.05]])
    assert judged(lambda: (next(tries), "")) == ("", 0.001)
    assert judged(lambda: ([0.001, 0.03], "")) == ("a call took 30.0 ms", 0.03)


def test_what_else_is_wrong_is_told_at_once() -> None:
    tries = iter([[0.05]])
    assert judged(lambda: (next(tries), "it raised ValueError")) == ("it raised ValueError", 0.05)

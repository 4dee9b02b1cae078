"""A boat with off-the-shelf sensors: a recording of a real boat, played onto a bus at its own speed, drives the vehicle.

The player is another process, as a real sensor is another computer; what is decoded is held against an independent decoder.
"""

import gzip
import logging
import math
import os
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest
from nmea2000.decoder import NMEA2000Decoder

from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.modes import Mode
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress
from delfim.parts.dsor.driver import Propellers
from delfim.parts.nmea2000.combining import Nmea2000Source
from delfim.parts.nmea2000.source import Nmea2000Navigation
from delfim.vehicle import console
from delfim.vehicle.grex import Guest
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.state import NoLog, State

RECORDING = Path(__file__).parents[2] / "data/nmea2000/raymarine-p70.candump.log.gz"
SECONDS = 5.0
POSITION_SOURCE = 43  # the only one with PGN 129025 on this boat

PLAYER = """
import gzip, select, sys, time
from delfim.canproxy.opening import open_can
from delfim.logging.candump import parse_line
rows = [line for line in gzip.open(sys.argv[2], "rt") if line.startswith("(")]
frames = [parse_line(row)[1] for row in rows]
with open_can(sys.argv[1]) as bus:
    sys.stdin.readline()
    start, first = time.monotonic(), frames[0].t_ns
    for frame in frames:
        due_s = (frame.t_ns - first) / 1e9
        if due_s > float(sys.argv[3]):
            break
        select.select([], [], [], max(0.0, start + due_s - time.monotonic()))
        bus.sendmsg(frame._replace(ifindex=0))
"""


def told_by_another_decoder() -> list[tuple[float, float]]:
    """(latitude_deg, longitude_deg) of each rapid position of the first SECONDS, by the package `nmea2000`."""
    logging.getLogger("nmea2000").setLevel(logging.ERROR)
    decoder, positions, first_s = NMEA2000Decoder(), [], None
    for row in gzip.decompress(RECORDING.read_bytes()).decode().splitlines():
        if not row.startswith("("):
            continue
        now_s = float(row[1:18])
        first_s = now_s if first_s is None else first_s
        if now_s - first_s > SECONDS:
            break
        message = decoder.decode(row.strip()) if row.split()[2].startswith("09F801") else None
        if message is not None:
            fields = {field.id: field.value for field in message.fields}
            positions.append((fields["latitude"], fields["longitude"]))
    return positions


def test_a_recorded_boat_drives_the_vehicle_at_its_own_speed_and_silence_stops_it():
    sensors, own = f"canloop:n2k-{os.getpid()}", f"canloop:own-{os.getpid()}"
    settings = config.Vehicle(
        boat=config.BoatTable(name="test"),
        navigation=config.NavigationTable(sources=("nmea2000",)),
        sysstat=config.Sysstat(required=()),
    )
    decoder, state, clock = Nmea2000Source(settings.nmea2000, settings.navigation.stale_s), State(), SystemClock()
    with open_can(sensors) as bus, open_can(own) as propulsion:
        bus.bind(*(CanAddress(arb, mask) for arb, mask in decoder.filters))
        source = Nmea2000Navigation(bus, decoder, state)
        outlet = Propulsion((Propellers(settings, propulsion),), propulsion, settings.thrusters, state)
        boat = VehicleLoop(settings, clock, state, (source,), outlet, Guest(state, clock), NoLog())
        command = [sys.executable, "-c", PLAYER, sensors, str(RECORDING), str(SECONDS)]
        with subprocess.Popen(command, stdin=subprocess.PIPE) as player:
            assert player.stdin is not None
            player.stdin.write(b"go\n")
            player.stdin.flush()
            positions, ages_s, chosen = [], [], set()
            until = time.monotonic() + 200
            while (len(positions) < 3 or state.mode is not Mode.IDLE) and time.monotonic() < until:
                if select.select([bus.fileno()], [], [], 0.1)[0] and boat.on_navigation(source):
                    n = state.navigation
                    positions.append((math.degrees(n.latitude_rad), math.degrees(n.longitude_rad)))
                    chosen.add(decoder.status(clock.monotonic_s()).kinds["position"].source)
                    ages_s.append(clock.time_ns() / 1e9 - state.profile.t0 / 1e9)
                    if len(positions) == 3:
                        assert boat.on_command(console.Heading(90.0, 1.0)) is None, "fit to leave idle on this navigation alone"
                boat.on_watchdog()
    expected = told_by_another_decoder()
    assert len(expected) > 20
    told = iter(expected)  # of two that waited at once the newest counts
    assert all(any(position == pytest.approx(each, abs=1e-7) for each in told) for position in positions)
    assert min(ages_s) >= 0.0, "the profile begins with the frame's arrival"
    assert state.reason.startswith("navigation silent for 1.")
    assert chosen == {POSITION_SOURCE}
    assert decoder.status(clock.monotonic_s()).kinds["position"].source is None, "and nobody is believed after the silence"

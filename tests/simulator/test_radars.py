"""A simulated radar on a port of NMEA 0183: what it tells of vessels and things, read by pynmea2, and when it stops."""

import math
from pathlib import Path

import pynmea2
import pytest

from delfim import config
from delfim.base.errors import ConfigError
from delfim.simulator.nodes import Nodes, nodes_of
from delfim.simulator.nodes.radars import LOST_S, MOST, TURN_S

NOON_NS = 1_795_348_800_200_000_000
NAUTICAL_M = 1852.0
BOAT = """
[boat]
name = "test"

[sensors]
names = ["sysstat", "nmea0183"]

[nmea0183.ports.radar]
device = "/dev/radar"

[payload.lidar]
command = ["/usr/bin/lidar"]
may = ["obstacles"]
"""
RADAR = '\n[[simulation.things.lookout]]\nport = "radar"\nkind = "radar"\n'
PERFECT = "missed = 0.0\nghosts = 0.0\n"
THING = "\n[[simulation.things.thing]]\nnorth_m = 120.0\neast_m = -50.0\n"
VESSEL = '\n[[simulation.traffic.vessel]]\nname = "DHOW"\nnorth_m = {}\neast_m = 80.0\ncourse_deg = 90.0\nspeed_mps = 3.0\n'


def world(tmp_path: Path, text: str, seed: int = 1) -> Nodes:
    file = tmp_path / "boat.toml"
    file.write_text(BOAT + text)
    return nodes_of(config.load(file), seed)


def said(nodes: Nodes, from_s: float, until_s: float) -> list[pynmea2.NMEASentence]:
    assert nodes.instruments is not None
    found = list[pynmea2.NMEASentence]()
    for i in range(round(from_s * 10), round(until_s * 10)):
        for vessel in nodes.vessels:
            vessel.sail(i / 10.0)
        for port, data in nodes.instruments.step(i / 10.0, NOON_NS):
            assert port == "radar"
            found += [pynmea2.parse(line, check=True) for line in data.decode().splitlines()]
    return found


def test_a_vessel_is_followed_from_its_third_echo_on_with_its_course_and_speed(tmp_path: Path) -> None:
    nodes = world(tmp_path, RADAR + PERFECT + "reach_m = 2000.0\n" + VESSEL.format(-200.0))
    told = said(nodes, 0.0, 60.0)
    plots = [each for each in told if each.sentence_type == "TTM"]
    assert [each.status for each in plots[:4]] == ["Q", "Q", "T", "T"]
    assert {each.target_number for each in plots} == {1}
    assert len(plots) == pytest.approx(60.0 / TURN_S, abs=2), "once in each turn of the aerial"
    (vessel,), last = nodes.vessels, plots[-1]
    assert (last.brg_ref, last.cog_unit, last.dist_unit) == ("T", "T", "N")
    assert float(last.distance) * NAUTICAL_M == pytest.approx(math.hypot(vessel.north_m, vessel.east_m), abs=15.0)
    bearing_deg = math.degrees(math.atan2(vessel.east_m, vessel.north_m)) % 360.0
    assert float(last.bearing) == pytest.approx(bearing_deg, abs=3.0)
    assert float(last.speed) * NAUTICAL_M / 3600.0 == pytest.approx(3.0, abs=0.6)
    assert float(last.cog) == pytest.approx(90.0, abs=15.0)


def test_a_thing_stands_where_its_position_says(tmp_path: Path) -> None:
    nodes = world(tmp_path, RADAR + PERFECT + THING)
    places = [each for each in said(nodes, 0.0, 60.0) if each.sentence_type == "TLL"]
    assert len(places) > 15
    origin = nodes.model.origin
    for each in places[3:]:
        north_m = (math.radians(each.latitude) - origin.latitude_rad) * origin.north_m_per_rad
        east_m = (math.radians(each.longitude) - origin.longitude_rad) * origin.east_m_per_rad
        assert (north_m, east_m) == pytest.approx((120.0, -50.0), abs=8.0)


def test_who_leaves_is_lost(tmp_path: Path) -> None:
    nodes = world(tmp_path, RADAR + PERFECT + VESSEL.format(0.0))
    said(nodes, 0.0, 20.0)
    told = said(nodes, 20.0, 20.0 + 400.0 / 3.0 + LOST_S)
    plots = [each for each in told if each.sentence_type == "TTM"]
    assert [each.status for each in plots].count("L") == 1
    assert plots[-1].status == "L"


def test_clutter_comes_and_goes_and_some_of_it_is_followed(tmp_path: Path) -> None:
    told = said(world(tmp_path, RADAR + "missed = 0.0\nghosts = 0.5\n"), 0.0, 120.0)
    states = [each.status for each in told if each.sentence_type == "TTM"]
    assert {"Q", "T", "L"} == set(states)
    assert 20 < states.count("L") < 100


def test_it_follows_no_more_than_it_can(tmp_path: Path) -> None:
    many = "".join(f"\n[[simulation.things.thing]]\nnorth_m = {50 + 3 * i}.0\neast_m = 20.0\n" for i in range(60))
    told = said(world(tmp_path, RADAR + PERFECT + many), 0.0, 20.0)
    assert len({each.target_number for each in told}) == MOST


def test_the_same_seed_says_the_same(tmp_path: Path) -> None:
    text = RADAR + "ghosts = 2.0\n" + THING
    first, again, other = (list(map(str, said(world(tmp_path, text, seed), 0.0, 30.0))) for seed in (1, 1, 2))
    assert first == again != other


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ('port = "radar"\npayload = "lidar"\nkind = "radar"', "and not both"),
        ('kind = "radar"', "a program, or a port"),
        ('port = "radar"\nkind = "lidar"', "only a radar"),
        ('port = "other"\nkind = "radar"', r"nmea0183\.ports\.other"),
        ('port = "radar"\nkind = "radar"\n' + RADAR, "already"),
    ],
)
def test_a_radar_that_nobody_can_hear_is_refused(tmp_path: Path, row: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        world(tmp_path, f"\n[[simulation.things.lookout]]\n{row}\n")

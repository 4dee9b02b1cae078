"""Other vessels of the simulated world: true motion, AIS with the intervals of M.1371, and what a judge measures of them."""

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.geodesy import to_plane, wrap
from delfim.base.vessels import VesselFacts, VesselPosition
from delfim.canproxy.nmea2000 import ais
from delfim.canproxy.nmea2000.fastpacket import FastPacket
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.model import Hull, Model
from delfim.simulator.nodes import nodes_of
from delfim.simulator.nodes.other_vessels import Shipping, axes_m, nearness
from delfim.simulator.nodes.other_vessels.frames import facts, framed, position
from delfim.simulator.nodes.other_vessels.sentences import facts_said, position_said
from delfim.simulator.tables import Sea, SimulatedTraffic, SimulatedVessel, Simulation, VesselTurn
from delfim.vehicle.state import NoLog

STEP_S = 0.2
Heard = list[tuple[float, VesselPosition | VesselFacts]]


def shipping(traffic: SimulatedTraffic, *, noise: bool = False, seed: int = 1) -> tuple[Shipping, Model]:
    settings = config.Vehicle(boat=config.BoatTable(name="test"), simulation=Simulation(noise=noise, traffic=traffic))
    model = Model(Hull(), Sea(), 1, math.radians(38.6), math.radians(-9.6), 0.0)
    return Shipping(settings, model, seed), model


def one(heard: str = "told", manner: str = "told", lost: float = 0.0, **row: Any) -> SimulatedTraffic:
    vessel = SimulatedVessel(mmsi=244_660_123, name="MARIA", **row)
    return SimulatedTraffic(heard=heard, manner=manner, lost=lost, vessel=(vessel,))


def listened(there: Shipping, seconds: float) -> Iterator[tuple[float, VesselPosition | VesselFacts]]:
    """What a boat on the bus hears."""
    fast, clock = {pgn: FastPacket(Counter()) for pgn in ais.PGNS}, ManualClock()
    while clock.monotonic_s() < seconds:
        for frame in there.step(clock.monotonic_s(), clock.time_ns()):
            pgn = frame.arb >> 11 & 0x3FFFF
            if (whole := fast[pgn].feed(frame.arb >> 3 & 0xFF, frame.data, clock.monotonic_s())) is not None:
                yield clock.monotonic_s(), ais.decode(pgn, whole)
        clock.advance(STEP_S)


def positions(heard: Heard) -> list[tuple[float, VesselPosition]]:
    return [(t_s, each) for t_s, each in heard if isinstance(each, VesselPosition)]


@pytest.mark.parametrize("is_a", [True, False])
def test_what_is_said_is_what_is_read(is_a):
    told = VesselPosition(244_660_123, 0.67, -0.16, 1.5, 4.2, 1.4 if is_a else None, 0.01 if is_a else None)
    pgn, data = position(told, 0 if is_a else None, 59)
    read = ais.decode(pgn, data)
    assert (pgn, len(data)) == ((ais.POSITION_A, 28) if is_a else (ais.POSITION_B, 27))
    assert isinstance(read, VesselPosition)
    assert read[0] == told[0]
    assert [value for value in read[1:7] if value is not None] == pytest.approx(
        [value for value in told[1:7] if value is not None], abs=1e-4
    )
    assert read[7:] == ("A" if is_a else "B", 0 if is_a else 15, 59, False)
    assert data[13] >> 2 == 59
    unknown = ais.decode(*position(VesselPosition(1, *[None] * 6), 0 if is_a else None, 60))
    assert unknown == VesselPosition(1, *[None] * 6, *("A", 0) if is_a else ("B", 15))


@pytest.mark.parametrize("is_a", [True, False])
def test_name_and_size_are_read_in_the_lengths_of_their_messages(is_a):
    told = VesselFacts(244_660_123, "MARIA", None, 70, 87.5, 12.1, 6.0, 20.0)
    said = list(facts(told, is_a))
    assert [(pgn, len(data)) for pgn, data in said] == ([(ais.STATIC_A, 76)] if is_a else [(ais.NAME_B, 27), (ais.SIZE_B, 35)])
    read = [ais.decode(pgn, data) for pgn, data in said]
    merged = [next((value for each in read if (value := each[i]) is not None), None) for i in range(len(told))]
    assert merged[:4] == list(told[:4])
    assert merged[4:] == pytest.approx(told[4:])
    assert len(framed(*said[0], 3)) == (11 if is_a else 4)


def test_a_vessel_sails_its_course_and_turns_at_its_rate():
    there, _ = shipping(one(speed_mps=5.0, turns=(VesselTurn(at_s=10.0, course_deg=90.0),), turn_dps=3.0))
    list(listened(there, 100.1))
    (vessel,) = there.vessels
    assert math.degrees(vessel.course_rad) == pytest.approx(90.0)
    radius_m = 5.0 / math.radians(3.0)  # a quarter of a circle, then 60 s to the east
    assert (vessel.north_m, vessel.east_m) == pytest.approx((50.0 + radius_m, radius_m + 300.0), abs=2.0)


@pytest.mark.parametrize(
    ("row", "interval_s"),
    [
        ({"transponder": "A", "speed_mps": 5.0}, 10.0),
        ({"transponder": "A", "speed_mps": 9.0}, 6.0),
        ({"transponder": "A", "speed_mps": 13.0}, 2.0),
        ({"transponder": "A", "speed_mps": 0.0, "status": 1}, 180.0),
        ({"transponder": "B", "speed_mps": 3.0}, 30.0),
        ({"transponder": "B", "speed_mps": 0.9}, 180.0),
    ],
)
def test_it_is_heard_as_often_as_its_class_and_speed_say(row, interval_s):
    there, _ = shipping(one(**row))
    times = [t_s for t_s, _ in positions(list(listened(there, 1000.0)))]
    gaps = [later - before for before, later in itertools.pairwise(times)]
    assert gaps == pytest.approx([interval_s] * len(gaps), abs=1e-6)
    assert times[0] < interval_s + STEP_S
    assert len(times) >= 1000.0 / interval_s - 1.0


def test_a_ship_that_turns_is_heard_more_often_and_tells_its_rate():
    there, _ = shipping(one(transponder="A", speed_mps=5.0, turns=(VesselTurn(at_s=100.0, course_deg=90.0),)))
    turning = [(t_s, each) for t_s, each in positions(list(listened(there, 200.0))) if 101.0 < t_s < 190.0]
    assert len(turning) > 20
    assert [each.rate_radps for _, each in turning] == pytest.approx([math.radians(1.0)] * len(turning), rel=0.01)


def test_name_and_size_come_at_once_and_then_every_six_minutes():
    there, _ = shipping(one(transponder="A", length_m=80.0, beam_m=14.0, antenna_m=-30.0))
    told = [(t_s, each) for t_s, each in listened(there, 800.0) if isinstance(each, VesselFacts)]
    assert told[0][0] < 21.0
    assert [later[0] - before[0] for before, later in itertools.pairwise(told)] == pytest.approx([360.0, 360.0])
    facts = told[0][1]
    assert (facts.from_starboard_m, facts.from_bow_m) == pytest.approx((7.0, 70.0)), "of the antenna"


def test_noise_wanders_loss_is_a_fifth_and_perfect_reports_are_exact():
    there, model = shipping(one(heard="B", lost=0.2, speed_mps=3.0, transponder="A"), noise=True)
    heard = positions(list(listened(there, 6_000.0)))
    assert len(heard) == pytest.approx(160, rel=0.1)
    errors = []
    for t_s, each in heard:
        assert each.latitude_rad is not None
        assert each.longitude_rad is not None
        north_m, east_m = to_plane(model.origin, each.latitude_rad, each.longitude_rad)
        errors += [north_m - 3.0 * t_s, east_m]
    assert math.sqrt(sum(error * error for error in errors) / len(errors)) == pytest.approx(5.0, rel=0.3)
    perfect, model = shipping(one(heard="perfect", lost=0.0, speed_mps=3.0), noise=True)
    for t_s, each in positions(list(listened(perfect, 60.0))):
        assert each.latitude_rad is not None
        assert each.longitude_rad is not None
        assert to_plane(model.origin, each.latitude_rad, each.longitude_rad) == pytest.approx((3.0 * t_s, 0.0), abs=0.02)


def test_name_and_size_were_told_before_the_run_began_and_are_known():
    """A run is cut from a longer voyage: the first telling stands for many, and is heard however much is lost."""
    for seed in range(20):
        there, _ = shipping(one(heard="B", lost=0.9, speed_mps=3.0, length_m=35.0), seed=seed)
        heard = [(t_s, each) for t_s, each in listened(there, 3000.0) if isinstance(each, VesselFacts)]
        assert heard[0][0] < 21.0
        assert {each.length_m for t_s, each in heard if t_s < 21.0} == {35.0, None}, "two messages: name, size"
        assert len(heard) < 16, "the later ones are lost as all else is"


@pytest.mark.parametrize("speed_mps", [0.8, 3.0])  # below 2 knots class B reports each 3 minutes
def test_a_position_was_told_before_the_run_began_and_is_known(speed_mps):
    for seed in range(20):
        there, _ = shipping(one(heard="B", lost=0.9, speed_mps=speed_mps), seed=seed)
        times = [t_s for t_s, _ in positions(list(listened(there, 3000.0)))]
        assert times[0] < (181.0 if speed_mps < 1.0 else 31.0)
        assert len(times) < 40, "the later ones are lost"


def test_the_same_seed_says_the_same_and_another_one_does_not():
    said = [list(listened(shipping(one(speed_mps=3.0), noise=True, seed=seed)[0], 300.0)) for seed in (1, 1, 2)]
    assert said[0] == said[1] != said[2]


@pytest.mark.parametrize(
    ("traffic", "silent"),
    [
        (one(heard="perfect", speed_mps=3.0, silent_from_s=50.0, silent_to_s=80.0), (50.0, 80.0)),
        (one(heard="perfect", speed_mps=3.0, silent_from_s=50.0), (50.0, 600.0)),
        (one(heard="perfect", manner="silent", speed_mps=3.0, meets_s=400.0), (250.0, 600.0)),
        (one(heard="perfect", manner="gap", speed_mps=3.0, meets_s=400.0), (200.0, 320.0)),
    ],
)
def test_it_falls_silent_as_its_row_or_its_manner_says(traffic, silent):
    times = [t_s for t_s, _ in positions(list(listened(shipping(traffic)[0], 600.0)))]
    assert not [t_s for t_s in times if silent[0] <= t_s < silent[1]]
    assert len(times) == pytest.approx(600.0 - (silent[1] - silent[0]), abs=3)


def test_one_without_a_transponder_sails_and_is_not_heard():
    there, _ = shipping(one(transponder="none", speed_mps=3.0))
    assert list(listened(there, 100.0)) == []
    assert there.vessels[0].north_m > 290.0


@pytest.mark.parametrize(
    ("manner", "meeting", "turned_deg"),
    [("rules", "stand-on", 40.0), ("late", "overtaken", 40.0), ("rules", "give-way", 0.0), ("told", "stand-on", 0.0)],
)
def test_who_keeps_the_rules_gives_way_to_starboard_and_comes_back(manner, meeting, turned_deg):
    there, _ = shipping(one(manner=manner, meeting=meeting, meets_s=600.0, speed_mps=3.0))
    list(listened(there, 550.0))
    assert math.degrees(there.vessels[0].course_rad) == pytest.approx(turned_deg)
    for t_s in range(551, 701):
        there.vessels[0].sail(float(t_s))
    assert math.degrees(there.vessels[0].course_rad) == pytest.approx(0.0)


def test_the_domain_is_longer_than_wide_and_measured_in_truth():
    assert axes_m(100.0) == (400.0, 160.0)
    assert axes_m(5.0) == (50.0, 30.0)
    assert nearness(0.0, 400.0, math.pi / 2.0, axes_m(100.0)) == pytest.approx(1.0), "ahead of a ship that goes east"
    row = SimulatedVessel(north_m=100.0, east_m=-60.0, course_deg=90.0, speed_mps=1.0, transponder="none")
    settings = config.Vehicle(
        boat=config.BoatTable(name="test"),
        simulation=Simulation(traffic=SimulatedTraffic(vessel=(row,))),
    )
    run = Lockstep(settings, 1, lambda clock: NoLog())
    list(run.cycles(120.0))
    (vessel,) = run.nodes.vessels
    assert vessel.nearest_m == pytest.approx(100.0, abs=1.0), "the boat lies still"
    assert vessel.nearest == pytest.approx(100.0 / 30.0, abs=0.05)
    assert vessel.nearest_s == pytest.approx(60.0, abs=3.0)


def test_latitude_and_longitude_are_taken_instead_and_only_together():
    there, _ = shipping(one(latitude_deg=38.6, longitude_deg=-9.59))
    assert there.vessels[0].east_m == pytest.approx(870.0, abs=5.0)
    with pytest.raises(ValueError, match="go together"):
        SimulatedVessel(latitude_deg=38.6)


def test_a_receiver_that_fails_is_silent_frozen_late_or_wrong():
    there, _ = shipping(one(heard="perfect", speed_mps=3.0))
    there.silent = True
    assert list(listened(there, 30.0)) == []
    there, _ = shipping(one(heard="perfect", speed_mps=3.0))
    there.frozen = True
    places = [each.latitude_rad for _, each in positions(list(listened(there, 30.0)))]
    assert len(set(places)) == 1 < len(places)
    there, model = shipping(one(heard="perfect", speed_mps=3.0))
    there.late_s = 60.0
    late = positions(list(listened(there, 90.0)))
    assert late[0][0] == pytest.approx(60.0, abs=1.0)
    for t_s, each in late:
        assert each.latitude_rad is not None
        assert (each.latitude_rad - model.origin.latitude_rad) * model.origin.north_m_per_rad == pytest.approx(
            3.0 * (t_s - 60.0), abs=1.0
        )
    there, model = shipping(one(heard="perfect", speed_mps=0.0))
    there.wrong_m = 2000.0
    wrong = [each.latitude_rad for _, each in positions(list(listened(there, 60.0)))]
    assert len(set(wrong)) == len(wrong) > 50


POSITION = ais.VesselPosition(
    244_660_123,
    math.radians(38.6912345),
    math.radians(-9.2154321),
    math.radians(123.4),
    4.2,
    math.radians(120.0),
    math.radians(0.5),
)
FACTS = ais.VesselFacts(244_660_123, "MARIA 2", "PA1234", 70, 87.0, 12.0, 5.0, 20.0)


def test_sentences_are_those_that_an_independent_decoder_reads_as_they_were_meant():
    """Each was read by pyais 3.3.1: number, 8.2 kn, 38.691235 N, 9.215432 W, 123.4 and 120 degrees, second 31; MARIA 2, PA1234,
    cargo, 20 m from bow, 67 m from stern, 7 m from port, 5 m from starboard."""
    assert position_said(POSITION, 0, 31) == b"!AIVDM,1,1,,A,13aDoVh6QBwEl:bF8rUDlShv0000,0*4F\r\n"
    class_b = POSITION._replace(heading_rad=None, rate_radps=None)
    assert position_said(class_b, None, 31) == b"!AIVDM,1,1,,A,B3aDoVh0DgmM2bUR>aE=;wgT0000,0*1F\r\n"
    assert list(facts_said(FACTS, True, 3)) == [
        b"!AIVDM,2,1,3,A,53aDoVh00001077;?@0l58T638000000000000162Q37540Ht00000000000,0*44\r\n!AIVDM,2,2,3,A,00000000000,2*27\r\n"
    ]
    assert list(facts_said(FACTS, False, 0)) == [
        b"!AIVDM,1,1,,A,H3aDoVhl58T63800000000000000,0*21\r\n",
        b"!AIVDM,1,1,,A,H3aDoVm60000000@1ijkl02Q3750,0*0D\r\n",
    ]


def test_a_boat_with_a_line_of_nmea_0183_hears_them_there():
    settings = config.Vehicle(
        boat=config.BoatTable(name="test"),
        sensors=config.Sensors(names=("nmea0183",)),
        nmea0183=Nmea0183(ports={"ais": Nmea0183Port(device="/dev/ais")}),
        simulation=Simulation(instruments=("ais:ais",), traffic=one(heard="perfect", speed_mps=3.0)),
    )
    nodes, said = nodes_of(settings, 1), b""
    assert nodes.instruments is not None
    for step in range(150):
        nodes.step(step * STEP_S, step * 200_000_000)
        for each in nodes.beside:
            each.step(step * STEP_S, step * 200_000_000)
        said += b"".join(data for port, data in nodes.instruments.step(step * STEP_S, 0) if port == "ais")
    lines = said.splitlines()
    assert sum(line.startswith(b"!AIVDM,1,1,,A,B") for line in lines) == pytest.approx(30, abs=1)
    assert sum(line.startswith(b"!AIVDM,1,1,,A,H") for line in lines) == 2
    assert max(map(len, lines)) <= 80


def test_a_forged_vessel_stays_beside_the_boat_and_changes_sides_and_one_that_chases_comes() -> None:
    there, model = shipping(one(follows_m=20.0, follows_deg=90.0, sides_s=30.0, speed_mps=3.0))
    chaser, its = shipping(one(chases=True, speed_mps=3.0, turn_dps=5.0, north_m=300.0))
    places = list[tuple[float, float]]()
    for t in range(301):
        for each, boat in ((there, model), (chaser, its)):
            boat.north_m, boat.east_m = -2.0 * t, 5.0
            each.step(t / 5.0, 0)
        places.append((there.vessels[0].north_m - model.north_m, there.vessels[0].east_m - model.east_m))
    assert places[100] == pytest.approx((0.0, 20.0))
    assert places[200] == pytest.approx((0.0, -20.0))
    vessel = chaser.vessels[0]
    bearing_rad = math.atan2(its.east_m - vessel.east_m, its.north_m - vessel.north_m)
    assert wrap(bearing_rad - vessel.course_rad) == pytest.approx(0.0, abs=0.01)

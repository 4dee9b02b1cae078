"""Sentences of several talkers and ports to navigation messages: who counts, how old, and when a message goes on."""

import math
from itertools import pairwise

import pytest

from delfim.canproxy.dsor.messages import Navigation
from delfim.lines.nmea0183.framing import Sentences, framed
from delfim.lines.nmea0183.sentences import KNOT
from delfim.parts.nmea0183.combining import TALKERS_MAX, Combined
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.vehicle.navigation.fusion import SLOW_S, VARIATION_S
from delfim.vehicle.state import Ping

DEG = math.radians
STALE_S = 2.5
HERE, THERE = "3841.4420,N,00912.9180,W", "3841.4430,N,00912.9180,W"


class Boat:
    """Lines of sentences, and what becomes of them."""

    def __init__(self, *ports: str, **more: object) -> None:
        table = {name: Nmea0183Port(device=f"/dev/{name}") for name in ports or ("gnss", "compass")}
        self.measured = dict[str, tuple[float, float]]()
        self.pings = list[Ping]()
        self.combined = Combined(Nmea0183(ports=table, **more), STALE_S, self.measured, sound=self.pings.append)
        self.now_s, self.lines = 100.0, {name: Sentences() for name in table}

    def hear(self, *bodies: str, port: str = "gnss") -> list[Navigation]:
        said = [each for body in bodies for each in self.lines[port].feed(framed(body))]
        assert not self.lines[port].refused
        return [n for each in said if (n := self.combined.take(port, each, self.now_s))]

    def kind(self, name: str) -> object:
        return self.combined.status(self.now_s)["kinds"][name]["talker"]


def gga(second: int, place: str = HERE, quality: int = 1) -> str:
    return f"GPGGA,1200{second:02d}.00,{place},{quality},9,0.9,10.0,M,50.0,M,,"


def rmc(second: int, place: str = HERE, knots: float = 2.0, status: str = "A", talker: str = "GP") -> str:
    return f"{talker}RMC,1200{second:02d}.00,{status},{place},{knots},90.0,221126,,,A"


VTG = "GPVTG,90.0,T,,M,2.0,N,3.7,K,A"


@pytest.mark.parametrize(
    "order",
    [
        lambda i: (gga(i), rmc(i)),
        lambda i: (rmc(i), VTG, gga(i), f"GPGLL,{HERE},1200{i:02d}.00,A,A"),
        lambda i: (gga(i), VTG),
        lambda i: (f"GPGLL,{HERE},1200{i:02d}.00,A,A", gga(i), rmc(i), VTG),
        lambda i: (rmc(i),),
        lambda i: (f"GPGLL,{HERE},1200{i:02d}.00,A,A",),
    ],
)
def test_an_instant_goes_on_once_with_its_own_velocity(order):
    boat = Boat()
    for i in range(4):
        boat.hear(*order(i))
        boat.now_s += 1.0
    for i in range(4, 20):
        told = boat.hear(*order(i))
        assert len(told) == 1
        assert told[0].latitude_rad == pytest.approx(DEG(38 + 41.4420 / 60))
        boat.now_s += 1.0
    if any("RMC" in each or "VTG" in each for each in order(0)):
        assert (told[0].north_mps, told[0].east_mps) == pytest.approx((0.0, 2.0 * KNOT), abs=1e-9)


def test_a_message_waits_for_the_velocity_of_its_instant():
    boat = Boat()
    for i in range(4):
        boat.hear(gga(i), rmc(i))
    assert boat.hear(gga(5)) == []
    assert boat.hear(rmc(5, knots=4.0))[0].east_mps == pytest.approx(4.0 * KNOT)


def test_an_rmc_with_every_tenth_gga_and_a_lost_sentence_cost_no_position():
    boat = Boat()
    told = [len(boat.hear(gga(i), *([rmc(i)] if i % 10 == 0 else []))) for i in range(60)]
    assert told[3:] == [1] * 57
    boat = Boat()
    for i in range(5):
        boat.hear(gga(i), rmc(i))
    assert boat.hear(gga(5)) == []  # its RMC was damaged
    assert [len(boat.hear(gga(i), rmc(i))) for i in range(6, 10)] == [1] * 4


def test_a_receiver_that_changes_its_order_is_followed():
    boat = Boat()
    for i in range(5):
        boat.hear(gga(i), rmc(i))
    assert [len(boat.hear(gga(i))) for i in range(5, 10)] == [0, 1, 1, 1, 1]


def test_a_plotter_that_says_something_else_each_second_is_heard_every_other_second_at_least():
    boat, told = Boat(), []
    for i in range(0, 56, 4):
        for each in ((rmc(i),), (VTG, f"GPGLL,{HERE},1200{i + 1:02d}.00,A,A"), (rmc(i + 2),), (gga(i + 3),)):
            told.append(len(boat.hear(*each)))
            boat.now_s += 1.0
    assert max(told) == 1
    assert max(b - a for a, b in pairwise(i for i, count in enumerate(told[4:]) if count)) == 2


def test_heading_and_position_come_from_different_ports_and_each_has_its_age():
    boat = Boat()
    boat.hear("HEHDT,274.0,T", "TIROT,60.0,A", port="compass")
    (n,) = boat.hear(rmc(1))
    assert n.heading_rad == pytest.approx(DEG(274.0))
    assert n.yaw_rate_radps == pytest.approx(DEG(1.0))
    assert n.utc_ns == 1795348801 * 10**9
    boat.now_s += STALE_S + 0.1
    (n,) = boat.hear(rmc(4))
    assert n.heading_rad is None
    assert n.yaw_rate_radps is None
    assert n.latitude_rad is not None
    assert boat.kind("heading") is None
    assert boat.kind("position") == "gnss:GP".replace("GP", "GN")


def test_satellite_systems_on_one_port_are_one_receiver():
    boat = Boat()
    for i, talker in enumerate(("GP", "GN", "GL", "GP")):
        assert len(boat.hear(rmc(i, talker=talker))) == 1
    assert list(boat.combined.status(boat.now_s)["talkers"]) == ["gnss:GN"]


def test_magnetic_headings_become_true_by_the_nearest_variation():
    boat = Boat(variation_deg=-2.0)

    def heading() -> float:
        (n,) = boat.hear(rmc(int(boat.now_s) % 60))
        boat.now_s += 1.0
        return round(math.degrees(n.heading_rad), 6)

    boat.hear("HCHDG,100.0,1.0,E,,", port="compass")
    assert heading() == 99.0, "the file's"
    boat.hear("GPRMC,120059.00,A," + HERE + ",2.0,90.0,221126,3.0,W,A")
    boat.hear("HCHDG,100.0,1.0,E,,", port="compass")
    assert heading() == 98.0, "the receiver's"
    boat.hear("HCHDG,100.0,1.0,E,4.0,E", port="compass")
    assert heading() == 105.0, "the compass' own"
    boat.now_s += VARIATION_S + 1.0
    boat.hear("HCHDM,100.0,M", port="compass")
    assert heading() == 98.0, "the file's again"


def test_the_better_sentence_of_a_compass_counts_while_it_comes():
    boat = Boat()
    boat.hear("HCHDM,10.0,M", "HCHDG,20.0,,,,", "HCHDT,30.0,T", "HCHDM,11.0,M", "HCHDG,21.0,,,,", port="compass")
    assert boat.hear(rmc(1))[0].heading_rad == pytest.approx(DEG(30.0))
    boat.hear("HCHDT,,T", "HCHDM,12.0,M", port="compass")
    assert boat.hear(rmc(2))[0].heading_rad == pytest.approx(DEG(12.0))


def test_of_two_compasses_the_preferred_one_then_the_port_that_stands_first():
    boat = Boat("gnss", "compass", preferred=("compass:HN",))
    boat.hear("HCHDT,10.0,T", "HNHDT,20.0,T", port="compass")
    boat.hear("GPHDT,30.0,T")
    assert boat.hear(rmc(1))[0].heading_rad == pytest.approx(DEG(20.0))
    boat.hear("HNHDT,,T", port="compass")
    assert boat.hear(rmc(2))[0].heading_rad == pytest.approx(DEG(30.0)), "the port gnss stands first"
    boat.hear("HNHDT,21.0,T", port="compass")
    assert boat.hear(rmc(3))[0].heading_rad == pytest.approx(DEG(21.0))


@pytest.mark.parametrize("no_fix", [gga(5, quality=0), gga(5, quality=6), rmc(5, status="V")])
def test_a_receiver_that_says_that_it_has_no_fix_has_no_position_at_once(no_fix):
    boat = Boat()
    for i in range(5):
        boat.hear(gga(i), rmc(i))
    first, last = (no_fix, rmc(5)) if "GGA" in no_fix else (gga(5), no_fix)
    (n,) = boat.hear(first, last)
    assert n.latitude_rad is None
    assert n.fix == 0


def test_quality_comes_from_gga_and_gsa_and_from_the_mode_where_there_is_nothing_else():
    boat = Boat()
    assert boat.hear(rmc(1))[0][9:12] == (3, 0, None)
    boat.hear("GNGSA,A,2,23,29,,,,,,,,,,,1.94,1.18,1.54")
    assert boat.hear(rmc(2))[0][9:12] == (2, 0, 1.18)
    boat.hear("GLGSA,A,1,,,,,,,,,,,,,99.9,99.9,99.9")
    assert boat.hear(rmc(3))[0].fix == 2, "a system without satellites"
    boat.hear(gga(4, quality=4))
    n = boat.hear(rmc(4), gga(5, quality=4))[-1]
    assert n[9:12] == (5, 9, 0.9)


def test_accuracy_and_the_age_of_corrections_are_in_the_message():
    boat = Boat()
    assert boat.hear(gga(1))[0][13:] == (None, None)
    boat.hear("GNGST,120001.00,,,,,0.03,0.04,0.05")
    (n,) = boat.hear(gga(2).removesuffix(",,") + ",1.4,0031")
    assert n[13:] == (pytest.approx(0.05), 1.4)
    boat.hear("GNGST,120002.00,,,,,,,")
    (n,) = boat.hear(gga(3))
    assert n[13:] == (None, None)
    gns = f"GNGNS,120003.00,{HERE},RR,20,0.7,10.0,50.0,3.0,0031,V"
    assert Boat().hear(gns)[0][9:] == (5, 20, 0.7, 1, None, 3.0)


def test_without_a_date_the_time_is_unknown():
    boat = Boat()
    assert boat.hear(gga(1))[0].utc_ns == 0
    boat.hear("GPZDA,120002.00,22,11,2026,00,00")
    assert boat.hear(gga(2))[0].utc_ns == 1795348802 * 10**9
    boat.now_s += SLOW_S + 0.1
    assert boat.hear(gga(5))[0].utc_ns == 0


def test_pitch_and_roll_by_the_names_and_signs_of_the_file():
    boat = Boat(pitch="-PTCH", roll="ROLL")
    boat.hear("YXXDR,A,-2.5,D,PTCH,A,7.0,D,ROLL,C,21.0,C,AIR", port="compass")
    assert boat.hear(rmc(1))[0][7:9] == pytest.approx((DEG(7.0), DEG(2.5)))
    assert Boat().hear(rmc(1))[0][7:9] == (None, None)


def test_values_beside_navigation_and_their_time():
    boat = Boat("gnss", "compass", "sounder")
    boat.hear("SDDPT,7.5,0.5,", "WIMWV,45.0,R,10.0,M,A", "WIMWV,60.0,T,18.0,K,A", port="sounder")
    boat.hear("GPGST,120000.00,,,,,3.0,4.0,5.0", "SDDPT,9.9,,")
    boat.hear("SDDPT,7.6,0.5,", port="sounder")
    told = Ping(100.0, 7.5, "nmea0183 sounder:SD", 0.5), Ping(100.0, 9.9, "nmea0183 gnss:SD")
    assert boat.pings == [*told], "the port gnss stands first"
    assert boat.measured["position_sigma_m"] == (5.0, 100.0)
    assert boat.measured["wind_apparent_rad"][0] == pytest.approx(DEG(45.0))
    assert boat.measured["wind_true_mps"][0] == pytest.approx(5.0)


def test_a_sounder_that_tells_each_depth_twice_is_heard_once():
    boat = Boat()
    for depth_m in (7.5, 7.6):
        boat.hear(f"SDDPT,{depth_m},0.5,", f"SDDBT,24.6,f,{depth_m},M,4.1,F")
    assert [(each.depth_m, each.offset_m) for each in boat.pings] == [(7.5, 0.5), (7.6, 0.5)]
    boat.now_s += 60.0
    boat.hear("SDDBT,24.6,f,7.7,M,4.1,F", "SDDPT,,,")
    assert boat.pings[-1][1:4] == (7.7, "nmea0183 gnss:SD", None), "the one sentence that goes on"


def test_the_height_of_the_antenna_is_that_above_the_ellipsoid():
    boat = Boat()
    boat.hear(gga(1))
    assert boat.measured["height_m"] == (60.0, 100.0)
    for second, changed in enumerate((",,M,50.0,M,,", ",10.0,M,,M,,", ",x,M,50.0,M,,", ",1e9,M,50.0,M,,"), 2):
        assert boat.hear(gga(second).replace(",10.0,M,50.0,M,,", changed)), "a position all the same"
        assert boat.measured["height_m"] == (60.0, 100.0)


def test_talkers_are_bounded():
    boat = Boat()
    for i in range(3 * TALKERS_MAX):
        boat.hear(f"{chr(81 + i % 10)}{i // 10}HDT,10.0,T")
    assert len(boat.combined.status(100.0)["talkers"]) == TALKERS_MAX
    assert boat.combined.status(100.0)["talkers_too_many"] == 2 * TALKERS_MAX


@pytest.mark.parametrize(("preferred", "pause_s"), [((), SLOW_S + 0.1), (("gnss",), 0.0), (("gnss:GN",), 0.0)])
def test_a_receiver_is_heard_after_noise_that_made_up_talkers(preferred, pause_s):
    """Those that are silent give way; to a preferred one the others, too."""
    boat = Boat(preferred=preferred)
    for i in range(TALKERS_MAX):
        boat.hear(f"{chr(81 + i % 10)}{i // 10}HDT,10.0,T", port="compass")
    boat.now_s += pause_s
    assert len([n for i in (1, 2) for n in boat.hear(gga(i)) if n.latitude_rad is not None]) == 2
    assert len(boat.combined.status(boat.now_s)["talkers"]) == TALKERS_MAX
    assert boat.combined.strangers == 0

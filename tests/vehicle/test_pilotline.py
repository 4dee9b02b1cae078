"""Survey software steers as it does any autopilot: sentences as pynmea2 writes them, the boat in lock step."""

import math

import msgspec
import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.errors import ConfigError, FormatError
from delfim.base.modes import Mode
from delfim.base.tables import decode
from delfim.lines.nmea0183.proprietary import FieldReader
from delfim.lines.nmea0183.tracklines import INVALID, MILE_M, TrackLine, track_line
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Guest
from delfim.services.access.exposure import doors
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.tables import Sea, Simulation
from delfim.vehicle import console
from delfim.vehicle.state import NoLog

DEVICE = "/dev/survey"


def sentence(kind: str, *fields: str) -> bytes:
    return (str(getattr(pynmea2, kind)("EC", kind, fields)) + "\r\n").encode()


def apb(cross_m: float, bearing_deg: float, north: str = "T", flags: str = "AA", passed: str = "V") -> bytes:
    """As plotters send it: three decimals of a mile, tenths of a degree."""
    side, away = "L" if cross_m > 0.0 else "R", f"{abs(cross_m) / MILE_M:.3f}"
    bearing = f"{bearing_deg % 360.0:05.1f}"
    return sentence("APB", *flags, away, side, "N", "V", passed, bearing, north, "WP2", bearing, north, bearing, north, "A")


def rmb(cross_m: float, range_m: float, bearing_deg: float, status: str = "A") -> bytes:
    side, away = "L" if cross_m > 0.0 else "R", f"{abs(cross_m) / MILE_M:.3f}"
    place = ("3841.0000", "N", "00912.0000", "W")
    ahead = (f"{range_m / MILE_M:.3f}", f"{bearing_deg % 360.0:05.1f}", "2.0", "V", "A")
    return sentence("RMB", status, away, side, "WP1", "WP2", *place, *ahead)


def xte(cross_m: float) -> bytes:
    return sentence("XTE", "A", "A", f"{abs(cross_m) / MILE_M:.3f}", "L" if cross_m > 0.0 else "R", "N")


def read(data: bytes) -> TrackLine | None:
    (fields,) = FieldReader().feed(data)
    return track_line(fields)


# Sentences.


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (apb(18.52, 90.0), TrackLine(18.52, math.pi / 2)),
        (apb(-18.52, 270.0, "M"), TrackLine(-18.52, 3 * math.pi / 2, True)),
        (apb(0.0, 90.0, flags="VA"), INVALID),
        (apb(0.0, 90.0, flags="AV"), INVALID),
        (apb(0.0, 90.0, passed="A"), INVALID),
        (sentence("APB", "A", "A", "0.1", "L", "K", "V", "V", "180", "T", "", "", "", "", ""), TrackLine(100.0, math.pi)),
        (sentence("APB", "A", "A", "0.1", "L", "N", "V", "V", "180", "T", "", "", "", "", "", "S"), INVALID),
        (xte(-9.26), TrackLine(-9.26, None)),
        (sentence("XTE", "A", "V", "0.1", "L", "N"), INVALID),
        (rmb(0.0, 1852.0, 45.0), TrackLine(0.0, math.pi / 4)),
        (rmb(0.0, 1852.0, 45.0, "V"), INVALID),
        (rmb(37.0, 18.52, 45.0), INVALID),
        (sentence("GLL", "3841.0000", "N", "00912.0000", "W"), None),
    ],
)
def test_a_line_to_steer_is_read(data: bytes, told: TrackLine | None) -> None:
    assert read(data) == (None if told is None else pytest.approx(told, abs=1e-6))


def test_the_line_of_rmb_follows_from_bearing_and_range() -> None:
    """100 m to starboard of a line to the north, 500 m before its end."""
    range_m, bearing_deg = math.hypot(100.0, 500.0), math.degrees(math.atan2(-100.0, 500.0))
    told = read(rmb(100.0, range_m, bearing_deg))
    assert told is not None
    assert told.course_rad is not None
    assert math.remainder(told.course_rad, math.tau) == pytest.approx(0.0, abs=0.005)


@pytest.mark.parametrize(
    "data",
    [
        sentence("APB", "A", "A", "0.1", "L", "N", "V", "V", "361", "T", "", "", "", "", ""),
        sentence("APB", "A", "A", "0.1", "", "N", "V", "V", "90", "T", "", "", "", "", ""),
        sentence("APB", "A", "A", "0.1", "L", "X", "V", "V", "90", "T", "", "", "", "", ""),
        sentence("APB", "A", "A", "nan", "L", "N", "V", "V", "90", "T", "", "", "", "", ""),
        sentence("APB", "A", "A", "", "L", "N", "V", "V", "90", "T", "", "", "", "", ""),
        sentence("APB", "A", "A", "0.1", "L", "N", "V", "V", "90", "", "", "", "", "", ""),
        sentence("APB", "A", "A", "0.1"),
        sentence("RMB", "A"),
        sentence("XTE", "A", "A", "-0.1", "L", "N"),
    ],
)
def test_a_sentence_that_tells_too_little_is_refused(data: bytes) -> None:
    with pytest.raises(FormatError):
        read(data)


fields = st.lists(
    st.one_of(st.sampled_from(("A", "V", "L", "R", "N", "K", "T", "M", "", "0.1", "90", "361")), st.text(max_size=6))
)


@given(st.sampled_from(("ECAPB", "GPRMB", "GPXTE", "APB", "")), fields)
def test_any_fields_are_a_line_within_bounds_or_refused(address: str, rest: list[str]) -> None:
    try:
        told = track_line([address, *rest])
    except FormatError:
        return
    if told is not None and told.course_rad is not None:
        assert 0.0 <= told.course_rad < math.tau
        assert told.cross_m is not None


# The boat.


def settings(current_mps: float = 0.0, **guest: object) -> config.Vehicle:
    simulation = Simulation(sea=Sea(current_mps=current_mps, current_to_deg=0.0), heading_deg=60.0)
    return config.Vehicle(
        boat=config.BoatTable(name="test"),
        simulation=simulation,
        nmea0183=Nmea0183(guest=Nmea0183Guest(device=DEVICE, **{"speed_mps": 1.5} | guest)),  # type: ignore[arg-type]
    )


class Survey:
    """A boat, and the software that wants it on a line to the east through its start."""

    def __init__(self, current_mps: float = 0.0, **guest: object) -> None:
        self.run = Lockstep(settings(current_mps, **guest), 1, lambda clock: NoLog())
        self._said_s = -1.0
        self.off_m: list[float] = []

    def says(self, data: bytes) -> None:
        self.run.lines[DEVICE].put(data)

    def sail(self, seconds: float, *speak: str, line_north_m: float = 0.0) -> None:
        """Once a second it says where the boat is off the line, by the position that it was told."""
        for state in self.run.cycles(seconds):
            off_m = line_north_m - state.motion.north_m  # starboard of a line to the east is south
            self.off_m.append(line_north_m - self.run.nodes.model.north_m)
            if speak and self.run.elapsed_s >= self._said_s + 1.0:
                self._said_s = self.run.elapsed_s
                ahead_m = 2000.0 - state.motion.east_m
                bearing_deg = 90.0 - math.degrees(math.atan2(off_m, ahead_m))
                said = {"APB": apb(off_m, 90.0), "RMB": rmb(off_m, math.hypot(off_m, ahead_m), bearing_deg), "XTE": xte(off_m)}
                for kind in speak:
                    self.says(said[kind])

    def given(self) -> str | None:
        return self.run.command(console.SetMode("grex"))


@pytest.mark.parametrize("speak", [("APB",), ("APB", "RMB", "XTE"), ("RMB",)], ids="+".join)
def test_the_boat_follows_the_line_within_two_metres_in_a_current_across_it(speak: tuple[str, ...]) -> None:
    survey = Survey(current_mps=0.5)
    survey.sail(3.0, *speak, line_north_m=10.0)
    assert survey.run.state.mode is Mode.IDLE, "nobody gave it the boat"
    assert survey.given() is None
    survey.sail(240.0, *speak, line_north_m=10.0)
    assert survey.run.state.mode is Mode.GREX
    assert max(abs(off_m) for off_m in survey.off_m[-600:]) < 2.0
    assert survey.run.nodes.model.east_m > 200.0


def test_the_boat_is_not_given_to_a_guest_that_says_nothing_and_holds_when_it_falls_silent() -> None:
    survey = Survey()
    survey.sail(3.0)
    assert survey.given() == "grex refused: no set point from the guest computer"
    survey.sail(3.0, "APB")
    assert survey.given() is None
    survey.sail(20.0, "APB")
    survey.sail(5.6)
    assert (survey.run.state.mode, survey.run.state.reason[:12]) == (Mode.HOLD, "guest silent")
    survey.sail(5.0, "APB")
    assert survey.run.state.mode is Mode.HOLD, "nothing is resumed by itself"


@pytest.mark.parametrize("word", [apb(0.0, 90.0, flags="VA"), apb(0.0, 90.0, passed="A"), b"$ECAPB,A,A*00\r\n", b"x" * 5000])
def test_warnings_the_end_of_the_line_and_noise_keep_no_guest_alive(word: bytes) -> None:
    survey = Survey()
    survey.sail(3.0, "APB")
    assert survey.given() is None
    for _ in range(6):
        survey.says(word)
        survey.sail(1.0)
    assert survey.run.state.mode is Mode.HOLD
    assert sum(survey.run.state.counts.get(name, 0) for name in ("guest_warns", "guest_malformed")) >= 1


def test_magnetic_bearings_need_a_known_variation() -> None:
    survey = Survey()
    survey.sail(1.0)
    survey.says(apb(0.0, 90.0, "M"))
    survey.sail(1.0)
    assert (survey.run.state.setpoint.guest_heading_rad, survey.run.state.counts["guest_magnetic"]) == (None, 1)
    known = Survey(variation_deg=-5.0)
    known.sail(1.0)
    known.says(apb(0.0, 90.0, "M"))
    known.sail(1.0)
    assert known.run.state.setpoint.guest_heading_rad == pytest.approx(math.radians(85.0))


def test_the_speed_is_the_files_until_the_operator_chooses_one() -> None:
    survey = Survey()
    survey.sail(3.0, "APB")
    assert survey.given() is None
    assert survey.run.state.setpoint.guest_speed_mps == 1.5
    assert survey.run.command(console.SetSpeed(0.8)) is None
    survey.sail(2.0, "APB")
    assert survey.run.state.setpoint.guest_speed_mps == 0.8


def test_its_set_points_go_through_the_guests_one_entrance() -> None:
    survey = Survey()
    heard: list[bytes] = []
    survey.run.guest.on_line = heard.append
    survey.sail(3.0, "APB")
    assert msgspec.json.decode(heard[-1]).keys() == {"heading_deg", "speed_mps"}


# The file.


@pytest.mark.parametrize(
    "device", ["udp:0.0.0.0:10111", "tcp-listen:192.168.7.2:4000", "tcp:192.168.7.20:4000", "gpsd:127.0.0.1:2947"]
)
def test_sentences_that_prove_nothing_come_from_this_computer_or_a_cable(device: str) -> None:
    tree = {"boat": {"name": "test"}, "nmea0183": {"guest": {"device": device}}}
    with pytest.raises(ConfigError):
        decode(tree, config.Vehicle, "test.toml")


def test_there_is_one_guest() -> None:
    tree = {"boat": {"name": "test"}, "nmea0183": {"guest": {"device": DEVICE}}, "guest": {"enabled": True}}
    with pytest.raises(ConfigError, match="two guests would steer by turns"):
        decode(tree, config.Vehicle, "test.toml")


def test_a_port_of_this_computer_is_a_door_by_which_one_steers() -> None:
    file = msgspec.structs.replace(settings(), nmea0183=Nmea0183(guest=Nmea0183Guest(device="udp:127.0.0.1:10111")))
    (door,) = (each for each in doors(file, ()) if "10111" in each.place)
    assert (door.reach, door.may, door.fault) == ("here", "be the guest computer, which steers in mode grex", "")

"""The thrusters of a vehicle's file: which descriptions are those of a boat, and what is said of the others."""

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.errors import ConfigError
from delfim.config import DELFIMX, ThrusterTable, load, pushes

BOAT = '[boat]\nname = "test"\n'
LEFT = '[[thrusters]]\nname = "left"\ndriver = "dsor"\naddress = 1\ny_m = -0.4\nthrust_n = [-30, 50]\n'
RIGHT = '[[thrusters]]\nname = "right"\ndriver = "dsor"\naddress = 0\ny_m = 0.4\nthrust_n = [-30, 50]\n'


def of(tmp_path, text):
    file = tmp_path / "boat.toml"
    file.write_text(text if "boat" in text else f"{text}\n{BOAT}")
    return load(file)


def test_a_file_without_rows_and_the_file_of_delfimx_have_the_same_thrusters(tmp_path):
    assert of(tmp_path, "").thrusters == DELFIMX == load("etc/delfimx.toml").thrusters == load("etc/delfimx-sea.toml").thrusters


def test_rows_are_taken_in_their_order_with_law_or_curve(tmp_path):
    curve = "curve = [[-1, -30], [-0.1, 0], [0, 0], [0.1, 0], [0.1, 8], [1, 50]]"
    found = of(tmp_path, RIGHT + LEFT.replace("thrust_n = [-30, 50]", curve)).thrusters
    assert [(row.name, row.ends_n) for row in found] == [("right", (-30.0, 50.0)), ("left", (-30.0, 50.0))]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("thrusters = []", "thrusters: "),
        (RIGHT + LEFT.replace("address = 1", "address = 0"), "right and left have one address, 0 of dsor"),
        (RIGHT + LEFT.replace("address = 1", "address = 2"), "left: dsor has address 0, starboard, and 1, port"),
        (RIGHT + LEFT.replace('"left"', '"right"'), "two have the name right"),
        (RIGHT + LEFT.replace('"left"', '"Left!"'), 'thrusters[1].name: "Left!" is not allowed (allowed: a small letter'),
        (RIGHT + LEFT.replace('"dsor"', '"oars"'), 'thrusters[1].driver: "oars" is not allowed (allowed: '),
        (RIGHT + LEFT.replace("[-30, 50]", "[50, -30]"), "thrusters[1]: thrust_n: [50, -30] has ahead and astern exchanged"),
        (RIGHT + LEFT.replace("[-30, 50]", "[-30, 0]"), "has ahead and astern exchanged"),
        (RIGHT + LEFT.replace("thrust_n = [-30, 50]", ""), "either thrust_n = [astern, ahead] or a curve"),
        (RIGHT + LEFT + "curve = [[-1, -30], [1, 50]]", "either thrust_n = [astern, ahead] or a curve"),
        (RIGHT, "this boat cannot turn to starboard"),
        (LEFT.replace("-30, 50", "0, 50"), "this boat cannot turn to port"),
        (RIGHT.replace("0.4", "0") + LEFT.replace("-0.4", "0"), "this boat cannot turn to starboard"),
        (RIGHT + "angle_deg = 90\n" + LEFT + "angle_deg = 90", "none of them pushes the boat ahead"),
        (RIGHT + LEFT + 'steer = { kind = "rudder" }', "left: dsor has address 0, starboard, and 1, port, and turns nothing"),
        (RIGHT + LEFT + 'steer = { kind = "rudder", angle_max_deg = 80 }', "a rudder at 80 degrees brakes; 60 at most"),
        (RIGHT + LEFT + 'steer = { kind = "azimuth", forbidden_deg = [[9, 3]] }', "from 9 to 3 is no sector"),
        ("[propulsion]\nrpm_max = 1200", "propulsion.rpm_max: unknown key; it is now dsor.rpm_max"),
        ("[propulsion]\nrpm_per_s_max = 800", "propulsion.rpm_per_s_max: unknown key; it is now rate_per_s of [[thrusters]]"),
        ("[propulsion]\nspeed_per_rpm_mps = 0.002", "propulsion.speed_per_rpm_mps: unknown key; it is now boat.full_mps"),
        ("[control.heading]\np_rpm_per_rad = 700", "control.heading.p_rpm_per_rad: unknown key; it is now p_nm_per_rad"),
        ("[control.speed]\ni_limit_rpm = 400", "control.speed.i_limit_rpm: unknown key; it is now i_limit_n"),
        ('[propulsion]\nactuators = ["dsor"]', "propulsion.actuators: unknown key; it is now [[thrusters]] with a driver"),
    ],
)
def test_what_is_no_boat_is_refused_in_words(tmp_path, text, words):
    with pytest.raises(ConfigError) as refused:
        of(tmp_path, text)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("curve", "words"),
    [
        ("[[-1, -30], [0.5, 40], [0.6, 30], [1, 50]]", "it is not monotonic: 30 N at 0.6 after 40 N at 0.5"),
        ("[[-1, 30], [0, 0], [1, -50]]", "ahead and astern are exchanged: the greatest command gives the least force"),
        ("[[-1, -30], [1, 50], [0.5, 20]]", "the command 0.5 comes after 1: they must rise"),
        ("[[-0.5, -30], [1, 50]]", "it must go from the command -1, or 0 where it gives nothing astern, to 1"),
        ("[[0, 0], [0.9, 50]]", "it must go from the command -1"),
        ("[[0, 0], [1, 0]]", "there must be some ahead"),
        ("[[-1, -30], [0.2, -5], [1, 50]]", "it needs the point [0, 0]"),
        ("[[-1, -30], [0, 0], [0, 5], [1, 50]]", "it needs the point [0, 0], and no other at the command 0"),
        ("[[-2, -30], [1, 50]]", "-2 is not allowed"),
        ("[[0, nan], [1, 50]]", "is not allowed"),
    ],
)
def test_a_curve_that_no_thruster_has_is_refused_in_words(tmp_path, curve, words):
    with pytest.raises(ConfigError) as refused:
        of(tmp_path, RIGHT + LEFT.replace("thrust_n = [-30, 50]", f"curve = {curve}"))
    assert words in str(refused.value)


NUMBERS = st.floats(-1.0, 1.0)


@given(st.lists(st.tuples(NUMBERS, st.floats(-100.0, 100.0)), max_size=6))
def test_a_curve_that_is_taken_rises_from_force_astern_to_force_ahead(points):
    try:
        row = ThrusterTable(name="motor", driver="dsor", curve=tuple(points))
    except ValueError:
        return
    commands, forces = zip(*row.curve, strict=True)
    assert list(commands) == sorted(commands)
    assert list(forces) == sorted(forces)
    assert row.ends_n[0] <= 0.0 < row.ends_n[1]


def test_a_rudder_turns_the_boat_both_ways_and_a_propeller_astern_does_not_use_it():
    row = ThrusterTable(name="motor", driver="dsor", x_m=-1.0, thrust_n=(-30.0, 50.0), steer=config.Steer(kind="rudder"))
    moments = [moment_nm for _, _, moment_nm in pushes(row)]
    most = 50.0 * math.sin(math.radians(35.0))
    assert (min(moments), max(moments)) == pytest.approx((-most, most))
    assert all(sway_n == 0.0 for surge_n, sway_n, _ in pushes(row) if surge_n < 0.0)


def test_the_rows_survive_the_way_into_a_log_and_back():
    assert msgspec.convert(msgspec.json.decode(msgspec.json.encode(DELFIMX)), config.Thrusters) == DELFIMX


@pytest.mark.parametrize(
    ("source", "driver", "nodes"),
    [
        ("dsor", "dsor", ("gps", "propeller_starboard", "propeller_port", "batteries_starboard", "batteries_port")),
        ("dsor", "pwm", ("gps",)),
        ("nmea2000", "dsor", ("propeller_starboard", "propeller_port", "batteries_starboard", "batteries_port")),
        ("nmea2000", "pwm", ()),
    ],
)
def test_the_nodes_that_must_report_are_those_that_the_boat_has(tmp_path, source, driver, nodes):
    text = f'[navigation]\nsources = ["{source}"]\n{RIGHT}{LEFT}'.replace('driver = "dsor"', f'driver = "{driver}"')
    assert of(tmp_path, text).sysstat.required == nodes
    assert of(tmp_path, f'{text}\n[sysstat]\nrequired = ["gps"]\n').sysstat.required == ("gps",)


@pytest.mark.parametrize("angle_max_deg", [90.0, 135.0, 180.0])
def test_a_thruster_that_turns_all_round_turns_the_boat(angle_max_deg):
    """Its force is greatest to the side at a quarter of a turn, and not where its turning ends."""
    steer = config.Steer(kind="azimuth", angle_max_deg=angle_max_deg)
    row = ThrusterTable(name="pod", driver="dronecan", x_m=-1.0, thrust_n=(0.0, 50.0), steer=steer)
    assert max(moment_nm for _, _, moment_nm in pushes(row)) == pytest.approx(50.0)
    assert config.Vehicle(boat=config.BoatTable(name="test"), thrusters=(row,)).thrusters == (row,)

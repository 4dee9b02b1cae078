"""The vehicle's file: what is taken, and what a tired person is told about what is not."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, get_args, get_origin, get_type_hints

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base import frames, tables
from delfim.base.errors import ConfigError
from delfim.base.tables import Table
from delfim.canproxy.dsor import messages
from delfim.config import OTHER_NODES, TAKEN_VEHICLES, ServiceTable, Vehicle
from delfim.services.access.exposure import doors

BOAT_KEYS = ", ".join(config.BoatTable.__struct_fields__)
BOAT = '[boat]\nname = "delfimx"\n'


def load(tmp_path: Path, text: str) -> Vehicle:
    file = tmp_path / "boat.toml"
    file.write_text(text, encoding="utf-8")
    return config.load(file)


def refused(tmp_path: Path, text: str) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, text)
    assert caught.value.file == str(tmp_path / "boat.toml")
    return caught.value


def test_a_name_is_enough(tmp_path: Path) -> None:
    assert load(tmp_path, BOAT) == Vehicle(boat=config.BoatTable(name="delfimx"))


def test_defaults_lie_within_their_own_ranges() -> None:
    """Defaults are not checked when they are used, so they are checked here."""
    vehicle = Vehicle(boat=config.BoatTable(name="x"))
    assert msgspec.convert(msgspec.to_builtins(vehicle), Vehicle) == vehicle


def test_tables_arrays_and_services(tmp_path: Path) -> None:
    vehicle = load(
        tmp_path,
        BOAT
        + """
        [navigation]
        sources = ["nmea2000", "dsor"]
        rate_hz = 10
        [control.heading]
        p_nm_per_rad = 0
        [runtime]
        cpus = [0, 3]
        [services.httpd]
        place = "process"
        [services.log-guard]
        enabled = false
        """,
    )
    assert vehicle.navigation.sources == ("nmea2000", "dsor")
    assert vehicle.navigation.rate_hz == 10.0
    assert vehicle.control.heading.p_nm_per_rad == 0.0
    assert vehicle.runtime.cpus == (0, 3)
    assert vehicle.services == {"httpd": ServiceTable(place="process"), "log-guard": ServiceTable(enabled=False)}


@pytest.mark.parametrize(
    ("text", "key", "reason", "allowed"),
    [
        # unknown keys
        (BOAT + "lenght_m = 3", "boat.lenght_m", "unknown key; did you mean length_m?", ""),
        (BOAT + "cruise = 2", "boat.cruise", "unknown key; did you mean control.speed.cruise_mps?", ""),
        (BOAT + "[control]\ncruise_mps = 2", "control.cruise_mps", "unknown key; did you mean control.speed.cruise_mps?", ""),
        (BOAT + "[ports.gps]", "ports", "unknown key; did you mean nmea0183.ports?", ""),
        (BOAT + "[heading]", "heading", "unknown key; did you mean control.heading?", ""),
        (BOAT + "[control.sonar]", "control.sonar", "unknown key", "heading, speed, path, goto, hold, home, unstick"),
        (
            BOAT + "[services.httpd]\ncolour = 1",
            "services.httpd.colour",
            "unknown key",
            "enabled, place, memory_max_mb, cpu_max, log",
        ),
        # missing parts
        ("", "boat", "missing", ""),
        ("[boat]\nid = 1", "boat.name", "missing", ""),
        # out of range
        (BOAT + "id = 250", "boat.id", "250 is not allowed", "1 to 249"),
        (BOAT + "id = 9999999999999999999999", "boat.id", "9999999999999999999999 is not allowed", "1 to 249"),
        (BOAT + "length_m = nan", "boat.length_m", "nan is not allowed", "0.01 to 10000.0"),
        (BOAT + "length_m = inf", "boat.length_m", "inf is not allowed", "0.01 to 10000.0"),
        (
            BOAT + "[failsafe.navigation_silent]\nafter_s = 0",
            "failsafe.navigation_silent.after_s",
            "0 is not allowed",
            "0.001 to 3600.0",
        ),
        (BOAT + "[control.speed]\nmax_mps = 1e-38", "control.speed.max_mps", "1e-38 is not allowed", "0.05 to 30.0"),
        (BOAT + "[control.speed]\nramp_mps2 = 1e-38", "control.speed.ramp_mps2", "1e-38 is not allowed", "0.01 to 10.0"),
        (
            BOAT + "[failsafe.console_silent]\nafter_s = 1e-38",
            "failsafe.console_silent.after_s",
            "1e-38 is not allowed",
            "0.5 to 3600.0",
        ),
        (BOAT + "[runtime]\nnice = 20", "runtime.nice", "20 is not allowed", "-20 to 19"),
        (BOAT + "[runtime]\ncpus = [0, -1]", "runtime.cpus[1]", "-1 is not allowed", "0 to 1023"),
        (BOAT + "[simulation.sea]\ngusts = 2", "simulation.sea.gusts", "2 is not allowed", "0.0 to 1.0"),
        (BOAT + "[log]\nfree_bytes_min = -1", "log.free_bytes_min", "-1 is not allowed", "0 or more"),
        (
            BOAT + "[navigation]\nsources = []",
            "navigation.sources",
            "an empty list is not allowed",
            "1 to 6 of dsor, nmea2000, dronecan, nmea0183, ins, mavlink_front_seat",
        ),
        # not one of the words
        (BOAT + '[log]\nwhen_full = "Panic"', "log.when_full", '"Panic" is not allowed', "delete-oldest, stop"),
        (
            BOAT + '[navigation]\nsources = ["gps"]',
            "navigation.sources[0]",
            '"gps" is not allowed',
            "dsor, nmea2000, dronecan, nmea0183, ins, mavlink_front_seat",
        ),
        (
            BOAT + '[services.ftpd]\n[services.httpd]\nplace = "moon"',
            "services.httpd.place",
            '"moon" is not allowed',
            "default, runtime, process",
        ),
        # other types
        ("boat = 3", "boat", "3 is a whole number, not a table", f"a table of {BOAT_KEYS}"),
        ('[[boat]]\nname = "x"', "boat", "this is a list, not a table", f"a table of {BOAT_KEYS}"),
        (BOAT + 'length_m = "4"', "boat.length_m", '"4" is text, not a number', "0.01 to 10000.0"),
        (BOAT + "length_m = true", "boat.length_m", "true is true or false, not a number", "0.01 to 10000.0"),
        (BOAT + "length_m = 1979-05-27", "boat.length_m", "1979-05-27 is a date, not a number", "0.01 to 10000.0"),
        (BOAT + '[runtime]\nwindow = "yes"', "runtime.window", '"yes" is text, not true or false', "true or false"),
        (BOAT + "[log]\ndirectory = 3", "log.directory", "3 is a whole number, not text", "text"),
        (
            BOAT + "[services]\nhttpd = 3",
            "services.httpd",
            "3 is a whole number, not a table",
            "a table of enabled, place, memory_max_mb, cpu_max, log",
        ),
    ],
)
def test_refusals(tmp_path: Path, text: str, key: str, reason: str, allowed: str) -> None:
    error = refused(tmp_path, text)
    assert (error.key, error.reason, error.allowed) == (key, reason, allowed)
    assert key in str(error)
    assert reason in str(error)
    assert allowed in str(error)


@pytest.mark.parametrize(
    ("text", "key", "allowed"),
    [
        ('[boat]\nname = "3x"', "boat.name", "a letter, then up to 31 letters, digits, _ or -"),
        ('[boat]\nname = "x\\n"', "boat.name", "a letter, then up to 31 letters, digits, _ or -"),
        (BOAT + '[can]\ninterface = "CAN 0"', "can.interface", "a Linux interface as can0, canloop:NAME, or python-can:"),
        (BOAT + '[guest]\nlisten = "nohost"', "guest.listen", "ADDRESS:PORT, port 0 to 65535"),
        (BOAT + '[httpd]\nlisten = "127.0.0.1:65536"', "httpd.listen", "ADDRESS:PORT, port 0 to 65535"),
        (BOAT + '[services."9x"]\nenabled = true', "services.9x", "a letter, then up to 31 letters, digits, _ or -"),
    ],
)
def test_texts_of_another_form_are_told_the_form_in_words(tmp_path: Path, text: str, key: str, allowed: str) -> None:
    error = refused(tmp_path, text)
    assert error.key == key
    assert error.allowed.startswith(allowed)
    assert "regex" not in str(error)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"[boat", "not TOML: "),
        (BOAT.encode() + b'name = "again"', "not TOML: "),
        (b"\xff\xfe", "not UTF-8: invalid start byte at byte 0"),
    ],
)
def test_what_is_not_toml(tmp_path: Path, content: bytes, reason: str) -> None:
    file = tmp_path / "boat.toml"
    file.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        config.load(file)
    assert (caught.value.file, caught.value.key) == (str(file), "file")
    assert caught.value.reason.startswith(reason)


def test_text_needs_no_quotes_in_an_override(tmp_path: Path) -> None:
    """A shell takes them away."""
    file = tmp_path / "boat.toml"
    file.write_text(BOAT, encoding="utf-8")
    words = [
        "boat.name=Argo",
        "can.interface=canloop:can1",
        "log.directory=/tmp/my log",
        'httpd.listen="127.0.0.1:1"',
        "boat.id=3",
    ]
    vehicle = config.load(file, words)
    assert (vehicle.boat.name, vehicle.can.interface, vehicle.boat.id) == ("Argo", "canloop:can1", 3)
    assert (vehicle.log.directory, vehicle.httpd.listen) == ("/tmp/my log", "127.0.0.1:1")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[can]\nnode = 0x10", "node 16 is another one of the boat"),
        ("[can]\nvehicle = 0x40", "frames of vehicle 0x40 would be commands to propellers or nodes"),
        ("[can]\nvehicle = 0xA0", "frames of vehicle 0xa0 would be commands to propellers or nodes"),
        ("[can]\nvehicle = 0xC1", "193 is not allowed"),
        ("[can]\nbitrate_bps = 9_999", "9999 is not allowed"),
    ],
)
def test_numbers_on_the_bus_that_belong_to_others_are_refused(tmp_path: Path, text: str, reason: str) -> None:
    assert refused(tmp_path, BOAT + text).reason == reason


def test_every_other_node_and_every_command_is_known_to_be_taken() -> None:
    assert set(OTHER_NODES) == set(messages.Node) - {messages.Node.VEHICLE, messages.Node.BROADCAST}
    commands = (messages.PROPELLER_STARBOARD, messages.PROPELLER_PORT, messages.BATTERIES_STARBOARD, messages.BATTERIES_PORT)
    assert set(TAKEN_VEHICLES) == {frames.identifier(arb) & 0xF0 for arb in (*commands, messages.RESET)}


def test_each_linux_interface_has_its_bit_rate(tmp_path: Path) -> None:
    assert load(tmp_path, BOAT).bit_rates == {"can0": 500_000}
    both = load(tmp_path, BOAT + '[navigation]\nsources = ["nmea2000", "dsor"]\n[can]\nbitrate_bps = 1_000_000')
    assert both.bit_rates == {"can0": 1_000_000, "can1": 250_000}
    assert load(tmp_path, BOAT + '[can]\ninterface = "canloop:x"').bit_rates == {}


def test_everything_that_is_wrong_is_told_at_once() -> None:
    tree = tomllib.loads("""
        navigatoin = {}
        colour = "blue"
        [boat]
        id = 250
        length_m = "4"
        [runtime]
        cpus = [0, -1, 2, 5000]
        [fence]
        keep_out = [{centre = [[91, 0]], radius_m = 1.0}, {centre = [[0, 0]]}]
        [services.httpd]
        plaice = "moon"
        """)
    told = {wrong.key: (wrong.reason, wrong.allowed) for wrong in tables.complaints(tree, Vehicle, "f")}
    assert told["navigatoin"] == ("unknown key; did you mean navigation?", "")
    assert told["colour"][0] == "unknown key"
    assert "`delfim describe`" in told["colour"][1]
    assert told["boat.name"] == ("missing", "")
    assert told["boat.id"] == ("250 is not allowed", "1 to 249")
    assert told["boat.length_m"] == ('"4" is text, not a number', "0.01 to 10000.0")
    assert told["runtime.cpus[1]"][0] == "-1 is not allowed"
    assert told["runtime.cpus[3]"][0] == "5000 is not allowed"
    assert told["fence.keep_out[0].centre[0][0]"] == ("91 is not allowed", "-89.0 to 89.0")
    assert told["fence.keep_out[1]"] == ("a circle needs its centre and its radius", "")
    assert told["services.httpd.plaice"] == ("unknown key; did you mean place?", "")
    assert len(told) == 10


def test_a_value_of_any_length_is_told_on_a_line(tmp_path: Path) -> None:
    error = refused(tmp_path, f'[boat]\nname = "{"x" * 5000}"\n')
    assert error.key == "boat.name"
    assert len(str(error)) < 300


def test_missing_file_and_directory(tmp_path: Path) -> None:
    for path, reason in ((tmp_path / "none.toml", "No such file or directory"), (tmp_path, "Is a directory")):
        with pytest.raises(ConfigError, match=reason) as caught:
            config.load(path)
        assert caught.value.file == str(path)


def test_overrides_lie_over_the_file(tmp_path: Path) -> None:
    file = tmp_path / "boat.toml"
    file.write_text(BOAT, encoding="utf-8")
    vehicle = config.load(file, ["boat.id=7", 'services.httpd.place = "process"', "log.required=false"])
    assert (vehicle.boat.id, vehicle.services["httpd"].place, vehicle.log.required) == (7, "process", False)


@pytest.mark.parametrize("override", ["boat.id", "boat.id=", "boat.id=seven", "boat.name.x=1", "boat.name='x"])
def test_overrides_that_are_none_are_refused(tmp_path: Path, override: str) -> None:
    file = tmp_path / "boat.toml"
    file.write_text(BOAT, encoding="utf-8")
    with pytest.raises(ConfigError):
        config.load(file, [override])


trees = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8) | st.sampled_from(["place"]), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(st.sampled_from(["", *Vehicle.__struct_fields__]), trees)
def test_any_tree_is_taken_or_refused_with_a_key(table: str, tree: object) -> None:
    whole = {"boat": {"name": "x"}, table: tree} if table else {"x": tree}
    refusal = None
    try:
        tables.decode(whole, Vehicle, "f")
    except ConfigError as error:
        refusal = error
    assert table or refusal
    assert refusal is None or (refusal.key.startswith(table or "x") and refusal.reason)


def test_every_parameter_says_what_is_allowed() -> None:
    def check(kind: type[Table]) -> None:
        for name, hint in msgspec_hints(kind).items():
            if isinstance(hint, type) and issubclass(hint, Table):
                check(hint)
            else:
                assert tables.allowed(hint), name

    check(Vehicle)


def msgspec_hints(kind: type[Table]) -> dict[str, object]:
    return {field.name: field.type for field in msgspec.structs.fields(kind)}


def test_the_boats_own_file_is_obeyed() -> None:
    file = Path(__file__).parents[1] / "etc" / "delfimx.toml"
    assert config.load(file).boat.name == tomllib.loads(file.read_text(encoding="utf-8"))["boat"]["name"]


def test_what_everybody_may_read_holds_no_secret_and_is_still_a_vehicle(tmp_path: Path) -> None:
    user = '[ftpd.users.ana]\npassword = "scrypt:c2FsdA==:AAAA"\n'
    vehicle = load(tmp_path, f"{BOAT}{user}[[fence.keep_in]]\npolygon = [[0,0],[0,1],[1,1]]\n")
    shown = tables.shown(vehicle)
    assert shown["ftpd"]["users"] == {"ana": {"password": "scrypt:hidden:hidden", "upload": False}}
    again = tables.decode(shown, Vehicle, "log")
    assert again.ftpd.users["ana"].password not in vehicle.ftpd.users["ana"].password
    assert msgspec.structs.replace(again, ftpd=vehicle.ftpd) == vehicle


def test_every_key_that_is_named_like_a_secret_is_declared_as_one() -> None:
    def keys(kind: object, path: str) -> Iterator[tuple[str, object]]:
        if isinstance(kind, type) and issubclass(kind, Table):
            for name, hint in get_type_hints(kind, include_extras=True).items():
                yield f"{path}{name}", hint
                yield from keys(hint, f"{path}{name}.")
        for part in get_args(kind):
            yield from keys(part, path)

    named = {path: hint for path, hint in keys(Vehicle, "") if re.search(r"(password|secret|token|passphrase)$", path)}
    assert "ftpd.users.password" in named
    bare = [
        path
        for path, hint in named.items()
        if get_origin(hint) is not Annotated or "shown" not in (get_args(hint)[1].extra or ())
    ]
    assert bare == []


GNSS = '[navigation]\nsources = ["nmea0183"]\n[nmea0183.ports.gnss]\ndevice = "{}"\n'


@pytest.mark.parametrize(
    "device", ["/dev/serial/by-path/pci-0:1.0-port0", "udp:0.0.0.0:10110", "tcp:[fe80::1]:10110", "gpsd:127.0.0.1:2947"]
)
def test_a_line_of_nmea_0183_is_a_port_or_a_place_in_the_network(tmp_path: Path, device: str) -> None:
    assert load(tmp_path, BOAT + GNSS.format(device)).nmea0183.ports["gnss"].device == device


@pytest.mark.parametrize("device", ["ttyUSB0", "udp:10110", "tcp:plotter:10110", "udp:0.0.0.0:70000", "http:127.0.0.1:80"])
def test_other_lines_of_nmea_0183_are_refused(tmp_path: Path, device: str) -> None:
    assert refused(tmp_path, BOAT + GNSS.format(device)).key == "nmea0183.ports.gnss.device"


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ('[nmea0183]\npreferred = ["compas:HC"]', "there is no port compas"),
        ('[nmea0183]\nsenders = ["10.0.0.300"]', "10.0.0.300"),
        ('[nmea0183.ports.spare]\ndevice = "/dev/ttyUSB0"', "is read by nmea0183.ports.gnss.device already"),
        ('[slipd]\ndevice = "/dev/ttyUSB0"', "is read by slipd.device already"),
        ('[nmea0183.out.sonar]\nto = "/dev/ttyUSB0"', "is read by nmea0183.ports.gnss.device already"),
        ('[nmea0183.out.sonar]\nto = "/dev/ttyUSB1"\nrate_hz = 5.0', "RMC, HDT 5 times a second need 5000 baud"),
        ('[nmea0183.out.sonar]\nto = "tcp:127.0.0.1:10110"', "nmea0183.out.sonar.to"),
        ("".join(f'[nmea0183.ports.p{i}]\ndevice = "/dev/p{i}"\n' for i in range(8)), "ports and out: 8 at most"),
    ],
)
def test_lines_of_nmea_0183_that_contradict_others_are_refused(tmp_path: Path, more: str, words: str) -> None:
    assert words in str(refused(tmp_path, BOAT + GNSS.format("/dev/ttyUSB0") + more))


def test_nmea_0183_needs_a_line(tmp_path: Path) -> None:
    assert "needs a port" in str(refused(tmp_path, BOAT + '[sensors]\nnames = ["nmea0183"]'))


@pytest.mark.parametrize(
    ("device", "senders", "reach", "has_fault"),
    [
        ("udp:0.0.0.0:10110", "[]", "here", False),
        ("udp:127.0.0.1:10110", '["10.0.0.0/8"]', "here", False),
        ("udp:0.0.0.0:10110", '["10.0.0.7"]', "anyone", False),
        ("tcp-listen:0.0.0.0:10110", '["10.0.0.0/8"]', "anyone", True),
    ],
)
def test_a_line_that_hears_a_network_is_a_door(tmp_path: Path, device: str, senders: str, reach: str, has_fault: bool) -> None:
    settings = load(tmp_path, BOAT + GNSS.format(device) + f"[nmea0183]\nsenders = {senders}")
    (door,) = [door for door in doors(settings, ()) if "where it is" in door.may]
    assert (door.reach, bool(door.fault)) == (reach, has_fault)
    assert "0.0.0.0:10110" in door.place or reach == "here"


def test_a_line_that_this_computer_opens_is_no_door(tmp_path: Path) -> None:
    settings = load(tmp_path, BOAT + GNSS.format("tcp:10.0.0.7:10110"))
    assert not [door for door in doors(settings, ()) if "where it is" in door.may]


def test_the_digest_of_what_a_boat_sails_by_is_of_hull_motors_and_gains_alone():
    def digest(*overrides: str) -> str:
        return config.load(Path(__file__).parents[1] / "etc/boats/otter.toml", overrides).sails_by

    same = digest()
    assert len(same) == 8
    for override in ("boat.id=7", 'boat.name="other"', "adopted.proven=false", "failsafe.console_silent.after_s=9.0"):
        assert digest(override) == same, override
    for override in ("boat.mass_kg=61.0", "control.speed.cruise_mps=0.9", "compass.hard_ahead=0.1", 'adopted.on="2026-01-01"'):
        assert digest(override) != same, override

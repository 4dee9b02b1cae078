"""What a simulated boat has for itself: the number, folder, bus and ports that no other simulation has."""

import socket
from pathlib import Path

import msgspec
import pytest

from delfim import config
from delfim.base.errors import DelfimError
from delfim.simulator.workspace import folders, settings_of, workspace

VEHICLE = config.load(Path(__file__).parents[2] / "etc/delfimx.toml")


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def changed(overrides: list[str]) -> config.Vehicle:
    return config.load(Path(__file__).parents[2] / "etc/delfimx.toml", overrides)


def test_two_share_nothing():
    with workspace(None) as one, workspace(None) as two:
        assert two.number > one.number
        assert folders() == [one.folder, two.folder]
        its = [changed(settings_of(VEHICLE, each, ()).overrides) for each in (one, two)]
    for key in (
        lambda v: v.can.interface,
        lambda v: v.nmea2000.interface,
        lambda v: v.console.socket,
        lambda v: v.runtime.run_directory,
        lambda v: v.log.directory,
        lambda v: v.guest.listen,
        lambda v: v.mavlink.listen,
        lambda v: v.httpd.listen,
        lambda v: v.ftpd.listen,
        lambda v: v.sshd.listen,
        lambda v: v.cantcpd.listen,
        lambda v: v.boat.id,
    ):
        assert key(its[0]) != key(its[1])
    buses = {vehicle.can.interface for vehicle in its} | {vehicle.nmea2000.interface for vehicle in its}
    assert len(buses) == 4


def test_the_boats_radio_is_left_alone_with_its_key():
    """A file with a serial radio needs a key; its simulation has neither."""
    file = ['mavlink.key="/keys/mavlink"', 'mavlink.serial="/dev/ttyUSB0"']
    with workspace(None) as its:
        settings = changed(file + settings_of(changed(file), its, ()).overrides)
        assert "mavlink.serial" not in " ".join(settings_of(VEHICLE, its, ("mavlink.key", "mavlink.serial")).overrides)
    assert (settings.mavlink.serial, settings.mavlink.key) == ("", "")


def test_a_ros_of_another_computer_is_left_alone():
    with workspace(None) as its:
        routers = {
            place: changed(
                [f'ros.router="{place}"', *settings_of(changed([f'ros.router="{place}"']), its, ()).overrides]
            ).ros.router
            for place in ("tcp/192.168.1.7:7447", "tcp/127.0.0.1:7447", "")
        }
    assert routers == {"tcp/192.168.1.7:7447": "", "tcp/127.0.0.1:7447": "tcp/127.0.0.1:7447", "": ""}


def test_the_fleets_broker_is_left_alone_unless_it_is_named():
    file = ['mavlink.key="/keys/mavlink"', 'mavlink.peers=["127.0.0.1:14560"]', 'fleet.broker="mqtts://sea.example.org:8883"']
    file += ['fleet.credentials="/keys/broker"']
    with workspace(None) as its:
        settings = changed(file + settings_of(changed(file), its, ()).overrides)
        named = settings_of(changed(file), its, ("fleet.broker", "mavlink.key")).overrides
    assert (settings.fleet.broker, settings.fleet.credentials) == ("", "")
    assert not [each for each in named if each.startswith("fleet.")]


def test_what_the_boat_tells_others_and_its_pilot_are_not_the_real_ones():
    """A simulated position on a real plotter, or a real plotter that steers it, deceives somebody."""
    file = [
        'nmea0183.out.sonar.to="/dev/ttyUSB3"',
        'nmea0183.out.bridge.to="udp:192.168.7.255:10110"',
        'nmea0183.out.mine.to="udp:127.0.0.1:10111"',
        'nmea0183.guest.device="/dev/ttyUSB4"',
        "guest.enabled=false",
        'slipd.device="/dev/ttyUSB5"',
        'corrections.to="/dev/ttyUSB6"',
        'corrections.caster="ntrip://127.0.0.1:2101/NEAR"',
    ]
    with workspace(None) as its:
        told = settings_of(changed(file), its, ())
        settings, place = changed(file + told.overrides), its.folder.resolve()
        named = settings_of(changed(file), its, ("nmea0183.out.sonar", "nmea0183.out.bridge.to", "nmea0183.guest.device"))
    out = settings.nmea0183.out
    assert (out["sonar"].to, settings.nmea0183.guest.device) == (f"{place}/nmea0183-out-sonar", f"{place}/nmea0183-guest")
    assert out["bridge"].to.startswith("udp:127.0.0.1:")
    assert out["mine"].to == "udp:127.0.0.1:10111"
    assert (settings.slipd.device, settings.corrections.to) == ("", "")
    assert told.moved[0] == f"nmea0183.out.sonar.to is {place}/nmea0183-out-sonar"
    assert len(told.moved) == 3
    assert named.moved == []
    assert "nmea0183.out" not in " ".join(named.overrides)


def test_the_boats_hand_set_and_kill_switch_are_left_alone():
    file = ['handset.device="/dev/ttyAMA1"', "handset.mandatory=true", 'kill.chip="/dev/gpiochip0"', 'kill.line="KILL"']
    with workspace(None) as its:
        settings = changed(file + settings_of(changed(file), its, ()).overrides)
        named = settings_of(changed(file), its, ("handset.device",)).overrides
    assert (settings.handset.device, settings.handset.mandatory, settings.kill.chip) == ("", False, "")
    assert not [each for each in named if each.startswith("handset.")]


def test_a_port_of_another_program_is_passed_over():
    with socket.socket() as other, workspace(None) as its:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1] - 10 * (its.number - 1)
        got = its.address(f"127.0.0.1:{port}")
        assert got != f"127.0.0.1:{other.getsockname()[1]}"
        assert its.address(f"127.0.0.1:{port}") not in (got, f"127.0.0.1:{other.getsockname()[1]}")
        assert its.address("127.0.0.1:0") == "127.0.0.1:0"


def test_what_the_operator_named_is_taken_as_it_is():
    named = {"simulation.interface", "simulation.httpd", "boat.id", "guest.listen"}
    with workspace(None), workspace(None) as two:
        its = changed(settings_of(VEHICLE, two, named).overrides)
    assert (its.can.interface, its.boat.id) == (VEHICLE.simulation.interface, VEHICLE.boat.id)
    assert (its.httpd.listen, its.guest.listen) == (VEHICLE.simulation.httpd, VEHICLE.guest.listen)


def test_a_folder_in_use_is_refused_or_passed_over_and_free_again_afterwards(tmp_path):
    with workspace("run/sim"):
        with pytest.raises(DelfimError, match="another simulation runs there"), workspace("run/sim"):
            pass
        with workspace(None) as other:
            assert other.folder != Path("run/sim")
    with workspace("run/sim") as again:
        assert again.folder == Path("run/sim")


def test_what_the_operator_sets_wins_or_is_refused():
    with workspace(None) as its:
        named = ('ftpd.root="/srv"', 'httpd.listen="127.0.0.1:8123"')
        settings = changed([*named, *settings_of(changed([*named]), its, ("ftpd.root", "httpd.listen")).overrides])
        assert (settings.ftpd.root, settings.httpd.listen) == ("/srv", "127.0.0.1:8123")
        with pytest.raises(DelfimError, match=r"--set console\.socket: each simulation has its own; --output"):
            settings_of(VEHICLE, its, ("console.socket",))


def test_the_boat_in_the_water_may_be_wired_in_another_way_than_her_file_says():
    """A pod of the truth is reached by the driver and address that it has there, and turns as it does there."""
    told = config.load(Path(__file__).parents[2] / "etc/boats/otter.toml", ["adopted.proven=false"])
    starboard, port = told.thrusters
    exchanged = (starboard, port.address, True), (port, starboard.address, False)
    rows = tuple(msgspec.structs.replace(row, address=address, reversed=way) for row, address, way in exchanged)
    truth = msgspec.structs.replace(told, thrusters=rows)
    with workspace(None) as its:
        simulated = settings_of(told, its, (), truth)
        plain = settings_of(told, its, ())
        other = config.load(Path(__file__).parents[2] / "etc/boats/wam-v.toml")
        with pytest.raises(DelfimError, match="no motor of driver"):
            settings_of(told, its, (), other)
    assert "adopted.proven=true" in plain.overrides
    assert "adopted.proven=true" not in simulated.overrides, "her motors are not those of her file"
    file = Path(__file__).parents[2] / "etc/boats/otter.toml"
    here, there = config.load(file, simulated.overrides), config.load(file, simulated.world)
    motors = {row.address: row.name for row in there.thrusters}
    assert [(motors[row.address], row.reversed) for row in here.thrusters] == [("port", False), ("starboard", True)]
    assert plain.world == []


@pytest.mark.parametrize("name", ["boats/bait-boat", "boats/blueboat", "boats/otter", "boats/wam-v"])
def test_its_folder_may_have_blanks_in_its_name(name: str):
    """As `My boats` has: the chip, the board and the lines that are played lie in it."""
    file = Path(__file__).parents[2] / f"etc/{name}.toml"
    with workspace("my boat/run") as its:
        settings = settings_of(config.load(file), its, ())
        assert config.load(file, settings.overrides).runtime.run_directory.endswith("my boat/run")

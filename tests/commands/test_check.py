"""`delfim check` as it is typed: all mistakes at once, and what the file names that is not there."""

import importlib.util
from pathlib import Path

import pytest

from delfim.__main__ import main

VEHICLE = Path(__file__).parents[2] / "etc/delfimx.toml"


@pytest.fixture
def check(tmp_path, capsys):
    """What is said of a file, and the exit code."""

    def typed(text: str, *words: str) -> tuple[int, str, str]:
        file = tmp_path / "boat.toml"
        file.write_text(text)
        code = main(["check", str(file), *words])
        out, err = capsys.readouterr()
        return code, out.replace(f"{tmp_path}/", ""), err.replace(f"{tmp_path}/", "")

    return typed


def test_all_mistakes_are_told_at_once_in_plain_words(check):
    code, out, err = check('[boat]\nname = "my boat"\nid = "two"\n[navigatoin]\nrate_hz = 5\n')
    assert (code, out) == (2, "")
    assert err.splitlines() == [
        "delfim: boat.toml: 3 things are wrong:",
        '  boat.name: "my boat" is not allowed (allowed: a letter, then up to 31 letters, digits, _ or -)',
        '  boat.id: "two" is text, not a whole number (allowed: 1 to 249)',
        "  navigatoin: unknown key; did you mean navigation?",
    ]


def test_a_single_mistake_is_a_line(check):
    assert check('[boat]\nname = "x"\nid = 0\n') == (
        2,
        "",
        "delfim: boat.toml: boat.id: 0 is not allowed (allowed: 1 to 249)\n",
    )


def test_what_is_not_on_this_computer_is_a_warning(check, tmp_path):
    text = (
        '[boat]\nname = "x"\n[can]\ninterface = "can77"\n[mavlink]\nkey = "/no/such/key"\n[simulation]\nmission = "away.toml"\n'
        '[payload.sonar]\ncommand = ["/no/such/sonar"]\n'
    )
    code, out, err = check(text)
    assert (code, out) == (0, "boat.toml: x: nothing is wrong with this file\n")
    assert err.splitlines() == [
        "delfim: warning: can.interface: this computer has no can77; the boat needs it, `delfim sim` does not; "
        'a boat without a bus says "canloop:nodes"',
        "delfim: warning: mavlink.key: there is no file /no/such/key on this computer",
        "delfim: warning: payload.sonar.command: there is no program /no/such/sonar on this computer",
        "delfim: warning: boat.toml: simulation.mission: there is no file away.toml; put it beside the vehicle's file",
    ]
    assert main(["sim", str(tmp_path / "boat.toml"), "--lockstep"]) == 2


def test_a_camera_that_this_computer_cannot_show_is_a_warning(check, monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    text = (
        '[boat]\nname = "x"\n[can]\ninterface = "canloop:x"\n[camera.bow]\nsource = "/dev/video99"\n'
        '[camera.mast]\nsource = "test"\nwebrtc = true\n[camera.stern]\nsource = "rtsp://192.168.2.9/1"\n'
    )
    code, _, err = check(text)
    needs = "need the program ffmpeg, which this computer lacks"
    assert (code, err.splitlines()) == (
        0,
        [
            "delfim: warning: camera.bow.source: there is no /dev/video99 on this computer",
            f"delfim: warning: camera.bow.source: pictures of /dev/video99 {needs}",
            "delfim: warning: camera.mast.webrtc: only stills, for aiortc is not installed: pip install 'delfim[webrtc]'",
            f"delfim: warning: camera.stern.source: pictures of rtsp://192.168.2.9/1 {needs}",
        ],
    )


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ('[guest]\nenabled = true\nkey = "/dev/null"\nnetworks = ["192.168.1.0/24"]', "192.168.1.0/24 of guest.networks"),
        ('[mavlink]\nlisten = "0.0.0.0:14555"\npeers = ["192.168.1.20:14550"]', "192.168.1.20 of mavlink.peers"),
        ('[cantcpd]\nwatch = ["127.0.0.0/8", "192.168.1.7"]', "192.168.1.7 of cantcpd.watch"),
        ('[mavlink]\nlisten = "0.0.0.0:14555"\npeers = ["192.168.2.20:14550"]', ""),
    ],
)
def test_a_network_that_the_bus_takes_from_the_others_is_told(check, table, key):
    text = '[boat]\nname = "x"\n[can]\ninterface = "canloop:x"\n[canip]\nenabled = true\n'
    code, _, err = check(text + table)
    told = f"delfim: warning: canip.address: its network 192.168.1.0/24 has {key}, too: answers to it go onto the bus"
    assert (code, err.splitlines()) == (0, [told] if key else [])


def test_a_mission_that_is_wrong_is_told_too(check, tmp_path):
    (tmp_path / "wrong.toml").write_text(
        'version = 1\nname = "wrong"\n[[waypoint]]\nlatitude_deg = 91.0\nlongitude_deg = 0.0\n'
    )
    _, _, err = check('[boat]\nname = "x"\n[can]\ninterface = "canloop:x"\n', "--set", "simulation.mission=wrong.toml")
    assert err == "delfim: warning: wrong.toml: waypoint[0].latitude_deg: 91.0 is not allowed (allowed: -89.0 to 89.0)\n"


@pytest.mark.parametrize("name", ["delfimx.toml", "sensors.toml"])
def test_the_files_that_are_shipped_are_sound(name, capsys):
    assert main(["check", str(VEHICLE.with_name(name)), "--set", "can.interface=canloop:x"]) == 0
    err = capsys.readouterr().err
    assert all("nmea2000.interface" in line or "/dev/serial/by-id" in line for line in err.splitlines())


def test_what_is_sent_to_the_nmea_2000_bus_is_told(check):
    text = '[boat]\nname = "x"\n[can]\ninterface = "canloop:x"\n[nmea2000]\ninterface = "canloop:y"\nunique_number = 77\n'
    _, out, _ = check(text + 'send = ["heading", "battery"]\n')
    assert out.splitlines() == [
        "canloop:y: NMEA 2000 device c078af00ffc0004d sends heading (127250), battery (127508, 127506)",
        "boat.toml: x: nothing is wrong with this file",
    ]
    _, out, _ = check(text + 'preferred_sources = ["c07891002fb34d62"]\n')
    assert "device c078af00ffc0004d sends nothing but who it is" in out
    _, out, _ = check(text)
    assert "NMEA 2000" not in out
    _, _, err = check(text + 'preferred_sources = ["c0789100"]\n')
    assert "0 to 251 or a NAME of 16 hexadecimal digits in quotes" in err


def test_simulated_vessels_that_she_cannot_hear_are_told(check):
    vessel = '[[simulation.traffic.vessel]]\nname = "FERRY"\ncourse_deg = 255.0\nspeed_mps = 2.0\n'
    text = VEHICLE.read_text() + vessel
    _, _, err = check(text)
    assert "simulation.traffic: she hears none of these vessels: AIS comes by NMEA 2000" in err
    _, _, err = check(text, "--set", 'sensors.names=["sysstat", "nmea2000"]')
    assert "simulation.traffic" not in err
    lidar = '[payload.lidar]\ncommand = ["/usr/bin/lidar"]\nmay = ["obstacles"]\n'
    _, _, err = check(f'{text}{lidar}[[simulation.things.lookout]]\npayload = "lidar"\nkind = "lidar"\n')
    assert "simulation.traffic" not in err, "a look-out tells of vessels, too"

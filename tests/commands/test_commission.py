"""`delfim commission` and `delfim check --sea`: from a vehicle's file to a boat's files, as a person meets them."""

import os
import re
import shlex
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from delfim import config
from delfim.__main__ import main
from delfim.base.input.keys import read_key
from delfim.console.pages.admission import kept_token
from delfim.services.access.connection_limits import matches
from delfim.services.access.exposure import Entrance, doors
from delfim.services.suite import services
from delfim.services.tables import Tablet
from delfim.services.vehiclefile import changed

ROOT = Path(__file__).parents[2]
SEA, DESK = str(ROOT / "etc/delfimx-sea.toml"), str(ROOT / "etc/delfimx.toml")
WORDS = ("--yes", "--name", "Boat1", "--id", "7", "--network", "10.77.0.2/24", "--users", "ana, rui")
BOAT = {"boat.toml", "ftpd.pem", "guest.key", "mavlink.key", "ssh_host_ed25519"}
SHORE = {
    "boat.toml",
    "boat.crt",
    "known_hosts",
    "mavlink.key",
    *(f"{u}.{kind}" for u in ("ana", "rui") for kind in ("key", "password")),
}


def commission(place: Path, *words: str) -> int:
    return main(["commission", SEA, "--output", str(place), *words])


@pytest.fixture
def made(tmp_path: Path) -> Path:
    assert commission(tmp_path / "out", *WORDS) == 0
    return tmp_path / "out"


def public(key: Path) -> list[str]:
    """Kind and text of the public key that belongs to a private one."""
    return subprocess.run(["ssh-keygen", "-y", "-f", key], capture_output=True, text=True, check=True).stdout.split()[:2]


def of(file: Path | str, *overrides: str) -> list[Entrance]:
    settings = config.load(file, overrides)
    return doors(settings, [row.name for row in services(settings)])


def test_all_files_are_there_and_their_owners_alone(made: Path) -> None:
    files = {folder: {path.name for path in (made / folder).iterdir()} for folder in ("boat", "shore", "guest")}
    assert files == {"boat": BOAT, "shore": SHORE, "guest": {"guest.key"}}
    for path in (made, *made.rglob("*")):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


def test_the_boats_file_has_the_answers_and_keeps_the_comments(made: Path) -> None:
    vehicle, text = config.load(made / "boat/boat.toml"), (made / "boat/boat.toml").read_text()
    assert (vehicle.boat.name, vehicle.boat.id) == ("Boat1", 7)
    assert (vehicle.cantcpd.watch, vehicle.guest.networks) == (("127.0.0.0/8", "10.0.0.2", "10.77.0.0/24"), ("10.77.0.0/24",))
    comments = [line for line in Path(SEA).read_text().splitlines() if line.startswith("#")]
    assert [line for line in text.splitlines() if line.startswith("#")] == comments
    assert set(vehicle.ftpd.users) == set(vehicle.sshd.users) == {"ana", "rui"}


def test_what_steers_from_ros_aboard_may_come_to_the_guests_door(tmp_path: Path) -> None:
    """It comes from this computer, and has the key."""
    file = tmp_path / "boat.toml"
    ros = '[ros]\nrouter = "tcp/127.0.0.1:7447"\ncommands = true\n[guest]\nenabled = true\n'
    file.write_text(f'[boat]\nname = "Otter"\n{ros}')
    assert main(["commission", str(file), *WORDS, "--console", "10.0.0.2", "--output", str(tmp_path / "out")]) == 0
    vehicle = config.load(tmp_path / "out/boat/boat.toml")
    assert vehicle.guest.networks == ("127.0.0.0/8", "10.77.0.0/24")
    assert vehicle.guest.key


def test_keys_and_passwords_fit_their_locks(made: Path) -> None:
    vehicle = config.load(made / "boat/boat.toml")
    for user in ("ana", "rui"):
        assert matches((made / f"shore/{user}.password").read_text().strip(), vehicle.ftpd.users[user].password)
        shown = subprocess.run(
            ["ssh-keygen", "-y", "-f", made / f"shore/{user}.key"], capture_output=True, text=True, check=True
        )
        assert shown.stdout.split()[:2] == vehicle.sshd.users[user].keys[0].split()[:2]
    host = subprocess.run(
        ["ssh-keygen", "-y", "-f", made / "boat/ssh_host_ed25519"], capture_output=True, text=True, check=True
    )
    assert {line.split(" ", 1)[1] for line in (made / "shore/known_hosts").read_text().splitlines()} == {
        " ".join(host.stdout.split()[:2])
    }
    assert read_key(made / "boat/mavlink.key") == read_key(made / "shore/mavlink.key") != read_key(made / "guest/guest.key")
    assert read_key(made / "boat/guest.key") == read_key(made / "guest/guest.key")
    words = ("openssl", "verify", "-CAfile", made / "shore/boat.crt", made / "boat/ftpd.pem")
    assert subprocess.run(words, capture_output=True, text=True, check=False).returncode == 0


def test_two_boats_share_no_secret(made: Path, tmp_path: Path) -> None:
    commission(tmp_path / "second", *WORDS)
    for path in made.rglob("*"):
        if path.is_file():
            assert path.read_bytes() != (tmp_path / "second" / path.relative_to(made)).read_bytes(), path.name


def test_the_boats_of_a_fleet_have_one_key_for_their_consoles_and_nothing_else_in_common(made: Path, tmp_path: Path) -> None:
    second = tmp_path / "second"
    assert commission(second, *WORDS, "--fleet", str(made), "--id", "8") == 0
    files = [path.relative_to(made) for path in made.rglob("*") if path.is_file()]
    same = {each for each in files if (made / each).read_bytes() == (second / each).read_bytes()}
    assert same == {Path("boat/mavlink.key"), Path("shore/mavlink.key")}


def test_two_boats_of_a_fleet_with_one_number_are_refused(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file's number is the default: an order to one boat would move both."""
    assert commission(tmp_path / "second", *WORDS, "--fleet", str(made)) == 2
    assert f"--id 7: Boat1 in {made} has this number" in capsys.readouterr().err
    assert not (tmp_path / "second").exists()


@pytest.mark.parametrize("system", ["image", "debian"])
def test_the_commands_that_carry_are_typed_twice_and_know_blanks(system: str, tmp_path: Path, capsys, monkeypatch) -> None:
    """Who lost a key commissions again and carries the new one to where the old one is."""
    monkeypatch.chdir(tmp_path)
    for name, text in {
        "sudo": 'exec "$@"',
        "chown": "",
        "sed": "",
        "scp": 'cp -r "$2" "${3#*:}"',
        "ssh": 'eval "$3"',
        "service": "",
    }.items():
        (tmp_path / "bin").mkdir(exist_ok=True)
        (tmp_path / "bin" / name).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / "bin" / name).chmod(0o700)
    there = tmp_path / "there"
    for output in ("boat 1", "boat 2"):
        assert commission(Path(output), *WORDS, "--for", system) == 0
        told = capsys.readouterr().out.partition("To the guest computer")[0]
        lines = [line for line in told.splitlines() if line.startswith("    s")]
        typed = "\n".join(lines).replace("/mnt/.boat", str(there)).replace("/log/.boat", str(there))
        subprocess.run(["sh", "-e", "-c", typed], check=True, env={"PATH": f"{tmp_path}/bin:/usr/bin:/bin"}, timeout=60)
        assert {path.name: path.read_bytes() for path in there.iterdir()} == {
            path.name: path.read_bytes() for path in Path(output, "boat").iterdir()
        }


def test_the_commands_to_type_ashore_know_blanks(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert commission(Path("boat 1"), *WORDS) == 0
    told = capsys.readouterr().out.splitlines()
    console, ssh, lftp = (
        next(shlex.split(line) for line in told if line.startswith(f"    {program} "))
        for program in ("delfim console", "ssh", "lftp")
    )
    assert {"boat 1/shore/mavlink.key", "boat 1/shore/boat.toml"} <= {*console}
    assert (ssh[2], ssh[4]) == ("boat 1/shore/ana.key", 'UserKnownHostsFile="boat 1/shore/known_hosts"')
    assert lftp[4].endswith('ssl:ca-file "boat 1/shore/boat.crt"')


def test_a_user_who_has_an_ssh_key_keeps_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    subprocess.run(("ssh-keygen", "-q", "-t", "rsa", "-N", "", "-f", tmp_path / "own"), check=True)
    made, own = tmp_path / "out", tmp_path / "own.pub"
    assert commission(made, *WORDS, "--users", f"ana={own}, rui") == 0
    assert {path.name for path in (made / "shore").iterdir()} == SHORE - {"ana.key"}
    assert config.load(made / "boat/boat.toml").sshd.users["ana"].keys == (own.read_text().strip(),)
    assert "    ssh -o UserKnownHostsFile=" in capsys.readouterr().out


def test_it_says_what_to_copy_where_and_no_secret(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = tmp_path / "out"
    assert commission(made, *WORDS) == 0
    told = capsys.readouterr().out
    for words in ("VEHICLE=/log/.boat/boat.toml NET=eth0 ADDRESS=10.77.0.2/24", f"{made}/guest/guest.key", "delfim console"):
        assert words in told
    assert "sudo delfim shore /dev/ttyUSB0 --boats 10.0.0.1 --address 10.0.0.2 " in told
    for file in ("shore/ana.password", "guest/guest.key", "shore/mavlink.key"):
        assert (made / file).read_text().strip() not in told


def test_for_debian_it_says_the_commands_that_put_the_files_where_the_package_finds_them(tmp_path, capsys):
    made, default = tmp_path / "out", tmp_path / "default"
    assert commission(made, *WORDS, "--for", "debian") == 0
    told = capsys.readouterr().out
    assert f"    scp -r {made}/boat USER@10.77.0.2:.boat\n" in told
    assert "kernel" not in told
    default.write_text((ROOT / "docker/debian/default").read_text())
    (edit,) = re.findall(r"'sudo (sed .*) /etc/default/delfim'", told)
    subprocess.run([*edit.split(), default], check=True)
    assert "VEHICLE=/log/.boat/boat.toml\n" in default.read_text()


def test_keys_that_a_boat_knows_are_not_replaced(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (made / "boat/mavlink.key").read_text()
    assert commission(made, *WORDS) == 2
    assert "File exists" in capsys.readouterr().err
    assert (made / "boat/mavlink.key").read_text() == before


def test_a_boat_without_a_radio(tmp_path: Path) -> None:
    assert commission(tmp_path / "out", *WORDS, "--radio", "", "--console", "10.77.0.1") == 0
    vehicle = config.load(tmp_path / "out/boat/boat.toml")
    assert (vehicle.slipd.device, vehicle.mavlink.peers) == ("", ("10.77.0.1:14550",))


def test_a_boat_that_serves_the_page_gets_its_token_and_certificate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "boat.toml"
    file.write_text('[boat]\nname = "Otter"\n[tablet]\nlisten = "127.0.0.1:8765"\n[mavlink]\npeers = ["127.0.0.1:14561"]\n')
    made = tmp_path / "out"
    assert main(["commission", str(file), *WORDS, "--console", "10.77.0.1", "--output", str(made)]) == 0
    told = capsys.readouterr().out
    assert re.search(rf"tablet: https://[\d.]+:8765/ with the token of {made}/shore/tablet.token", told), told
    settings = config.load(made / "boat/boat.toml")
    its = settings.of(Tablet)
    assert (its.listen, its.certificate, its.directory) == ("0.0.0.0:8765", "/log/.boat/ftpd.pem", "/log/.boat/tablet")
    assert its.boats in settings.mavlink.peers
    token = (made / "shore/tablet.token").read_text()
    assert (made / "boat/tablet/token").read_text() == token
    assert kept_token(made / "boat/tablet/token") == token.strip()
    assert main(["check", "--sea", str(made / "boat/boat.toml")]) == 0


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("--yes",), 2, "--users is missing"),
        ((), 2, "nobody is here to ask: give --name, or --yes"),
        ((*WORDS, "--id", "250"), 2, "boat.id: 250 is not allowed"),
        ((*WORDS, "--for", "windows"), 2, "--for windows: there are image and debian"),
        ((*WORDS, "--id", "two"), 2, "--id two: not a number"),
        ((*WORDS, "--users", "ana,9x"), 2, "'9x': not a name"),
        ((*WORDS, "--users", f"ana={SEA}"), 2, "delfimx-sea.toml is no public ssh key"),
        ((*WORDS, "--users", "ana=/nowhere.pub"), 2, "/nowhere.pub is no public ssh key"),
        ((*WORDS, "--fleet", "/nowhere"), 2, "/nowhere/shore/mavlink.key"),
        ((*WORDS, "--network", "10.77.0.2"), 2, "not ADDRESS/LENGTH"),
        ((*WORDS, "--console", "ashore"), 2, "slipd"),
        ((*WORDS, "--console", "127.0.0.1"), 2, "that is the boat's own computer"),
        ((*WORDS, "--set", 'cantcpd.transmit=["10.77.0.0/24"]'), 1, "anyone in 10.77.0.0/24 may send frames"),
    ],
)
def test_a_wrong_answer_is_refused_and_nothing_is_written(tmp_path, capsys, words, code, told):
    assert commission(tmp_path / "out", *words) == code
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_person_is_asked_what_has_no_option(tmp_path: Path) -> None:
    import pty

    ours, theirs = pty.openpty()
    words = [sys.executable, "-m", "delfim", "commission", SEA, "--output", str(tmp_path / "out"), "--network", "10.77.0.2/24"]
    with subprocess.Popen([*words, "--interface", "eth1"], stdin=theirs, stdout=subprocess.PIPE, text=True) as process:
        os.write(ours, b"Boat9\n9\n\n\n\n\nana\n")  # the radio, both of its addresses and the image stay
        said, _ = process.communicate(timeout=200)
    os.close(ours)
    os.close(theirs)
    assert process.returncode == 0, said
    assert "Its number, 1 to 249, of which no other boat has the same [2]: " in said
    vehicle = config.load(tmp_path / "out/boat/boat.toml")
    assert (vehicle.boat.name, vehicle.boat.id, vehicle.slipd.device, set(vehicle.sshd.users)) == (
        "Boat9",
        9,
        "/dev/ttyS1",
        {"ana"},
    )


# What is open


def test_a_commissioned_boat_is_fit_for_sea_and_says_what_is_open(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["check", "--sea", str(made / "boat/boat.toml")]) == 0
    said = capsys.readouterr().out
    groups = re.split(r"^(?:Open to anyone|Behind a key or a password|On this computer alone):\n", said, flags=re.MULTILINE)[1:]
    names = [re.findall(r"^  (\S+)", group, re.MULTILINE) for group in groups]
    assert names == [["httpd", "cantcpd", "slipd"], ["mavlink", "guest", "ftpd", "sshd"], ["vehicle"]]
    assert "0.0.0.0:29536" in groups[0]
    assert "anyone in 10.0.0.2, 10.77.0.0/24: read the buses" in groups[0]
    assert "ana, rui, by password, over TLS: read /log; upload: ana, rui" in groups[1]


@pytest.mark.parametrize(
    ("override", "fault"),
    [
        (
            'cantcpd.transmit=["192.168.1.0/24"]',
            "cantcpd.transmit: anyone in 192.168.1.0/24 may send frames, which move the boat",
        ),
        ('cantcpd.transmit=["0.0.0.0/0"]', "cantcpd.transmit: anyone in 0.0.0.0/0 may send frames, which move the boat"),
        ('ftpd.certificate=""', "whoever hears a password may upload"),
        ("simulation.faults=true", "`delfim fault` break"),
    ],
)
def test_what_strangers_could_move_or_write_to_is_refused(made, capsys, override, fault):
    assert main(["check", "--sea", str(made / "boat/boat.toml"), "--set", override]) == 1
    captured = capsys.readouterr()
    assert fault in captured.err
    assert "nothing is wrong" not in captured.out


@pytest.mark.parametrize(
    "override",
    ['cantcpd.watch=["127.0.0.0/8"]', "ftpd.users.ana.upload=false", 'cantcpd.listen=["127.0.0.1:29536"]', 'mavlink.key=""'],
)
def test_what_only_this_computer_can_do_goes_to_sea(made: Path, override: str) -> None:
    more = ("--set", "ftpd.users.rui.upload=false", "--set", 'ftpd.certificate=""') if "upload" in override else ()
    transmit = ("--set", 'cantcpd.transmit=["0.0.0.0/0"]') if "cantcpd" in override else ()
    assert main(["check", "--sea", str(made / "boat/boat.toml"), "--set", override, *more, *transmit]) == 0


def test_the_desks_boat_is_open_to_this_computer_alone() -> None:
    assert {door.reach for door in of(DESK)} == {"here"}


def test_every_address_of_a_vehicles_file_is_a_door(made: Path) -> None:
    """A new key that listens somewhere belongs into `exposure`."""
    more = ['mavlink.serial="/dev/ttyS2"', 'cantcpd.slcan=["0.0.0.0:29537"]', 'fleet.broker="mqtts://broker.example:8883"']
    at_broker = ['mavlink.peers=["127.0.0.1:14560"]', 'mavlink.listen="0.0.0.0:14555"']
    settings = config.load(made / "boat/boat.toml", more + at_broker)
    told = " ".join(door.place for door in doors(settings, [row.name for row in services(settings)]))
    for name in settings.__struct_fields__:
        for key in ("listen", "slcan", "serial"):
            value = getattr(getattr(settings, name), key, ())
            for place in (value,) if isinstance(value, str) else value:
                assert place in told, f"{name}.{key}"


# The text of a vehicle's file


def test_values_are_changed_in_place_added_to_their_table_and_tables_at_the_end(tmp_path: Path) -> None:
    file = tmp_path / "boat.toml"
    file.write_text('[boat] # ours\nname = "a"  # of the boat\n\n# the bus\n[can]\ninterface = "can0"\n')
    text = changed(str(file), {"boat.name": 'b "#1"', "boat.id": 3, "guest.networks": ["10.0.0.0/8"], "can.node": 5})
    assert text == (
        '[boat]\nname = "b \\"#1\\""  # of the boat\nid = 3\n\n# the bus\n[can]\ninterface = "can0"\nnode = 5\n\n'
        '[guest]\nnetworks = ["10.0.0.0/8"]\n'
    )


@pytest.mark.parametrize("text", ['boat.name = "a"\n', '[boat]\nname = """\na"""\n', 'boat = { name = "a" }\n'])
def test_a_file_of_another_form_is_refused_not_spoilt(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "boat.toml"
    file.write_text(text)
    assert main(["commission", str(file), *WORDS, "--output", str(tmp_path / "out")]) == 2
    assert "delfim: " in capsys.readouterr().err

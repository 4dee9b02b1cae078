"""`delfim inventory` as it is typed: what the vehicle's file names, what its keys are, and no secret."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.__main__ import main
from delfim.services.access.exposure import doors
from delfim.services.access.inventory import _host, inventory
from delfim.services.suite import services

ROOT = Path(__file__).parents[2]
FILES = [
    *sorted((ROOT / "etc/boats").glob("*.toml")),
    ROOT / "etc/delfimx.toml",
    ROOT / "etc/delfimx-sea.toml",
    ROOT / "etc/lake.toml",
]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A boat that was commissioned, with its keys where its file says."""
    folder = tmp_path_factory.mktemp("boats") / "made"
    assert main(["commission", str(ROOT / "etc/delfimx-sea.toml"), "--output", str(folder), "--users", "ana", "--yes"]) == 0
    file = folder / "boat/boat.toml"
    payload = '\n[payload.sonar]\ncommand = ["/bin/true"]\nmay = ["hold"]\n[corrections]\nto = "/dev/ttyS9"\n'
    caster = f'caster = "ntrips://caster.example.org:2102/NEAR"\ncredentials = "{folder}/caster"\n'
    (folder / "caster").write_text("ana:not-to-be-seen\n")
    (folder / "caster").chmod(0o644)
    file.write_text(file.read_text().replace("/log/.boat", f"{folder}/boat") + payload + caster)
    return folder


def told(capsys: pytest.CaptureFixture[str], *words: str) -> dict[tuple[str, str], dict[str, str]]:
    assert main(["inventory", *words, "--json"]) == 0
    return {(item["kind"], item["name"]): item for item in json.loads(capsys.readouterr().out)["items"]}


def test_it_lists_whom_the_file_names_what_runs_and_what_is_where(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = told(capsys, str(made / "boat/boat.toml"))
    assert found["host", "10.0.0.2"]["what"] == "slipd.peer, mavlink.peers, cantcpd.watch"
    assert found["host", "caster.example.org"]["what"] == "corrections.caster"
    assert found["port", "mavlink"]["place"] == "0.0.0.0:14555 UDP"
    assert found["line", "corrections.to"]["place"] == "/dev/ttyS9"
    assert found["program", "payload:sonar"]["what"].startswith("user nobody, no network, may hold; sha256 ")
    assert found["program", "sshd"]["place"] == "process"
    assert found["version", "msgspec"]["what"] != "not on this computer"
    assert ("version", "pytest") not in found


def test_the_fingerprints_are_those_of_ssh_keygen_and_openssl(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = told(capsys, str(made / "boat/boat.toml"))
    host = subprocess.run(
        ["ssh-keygen", "-lf", made / "boat/ssh_host_ed25519"], capture_output=True, text=True, check=True
    ).stdout.split()[1]
    assert host in found["key", "sshd.host_key"]["what"]
    if shutil.which("openssl"):
        words = ["openssl", "x509", "-noout", "-fingerprint", "-sha256", "-in", made / "boat/ftpd.pem"]
        said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
        assert said.partition("=")[2].strip().replace(":", "").lower() in found["key", "ftpd.certificate"]["what"]
    assert found["key", "sshd.users.ana.keys"]["what"].startswith("public, ssh-ed25519 SHA256:")
    assert found["key", "corrections.credentials"]["what"].startswith("mode 0644, others may read it; a user and a password")


def test_boat_and_console_with_one_key_show_one_fingerprint(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours = told(capsys, str(made / "boat/boat.toml"))["key", "mavlink.key"]["what"]
    theirs = f'mavlink.key="{made}/shore/mavlink.key"'
    assert told(capsys, str(made / "boat/boat.toml"), "--set", theirs)["key", "mavlink.key"]["what"] == ours


def test_no_secret_is_in_it(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["--json"]):
        assert main(["inventory", str(made / "boat/boat.toml"), *words]) == 0
        out = capsys.readouterr().out
        secrets = [(made / f"boat/{name}.key").read_text().strip() for name in ("mavlink", "guest")]
        secrets += ["not-to-be-seen", (made / "shore/ana.password").read_text().strip()]
        secrets += [config.load(made / "boat/boat.toml").table("ftpd").users["ana"].password]
        assert not [secret for secret in secrets if secret in out]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_each_door_program_and_bus_of_each_boat_is_in_it(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = config.load(file)
    rows = [row.name for row in services(settings)]
    assert main(["inventory", str(file), "--json"]) == 0
    items = [(item["kind"], item["name"], item["place"]) for item in json.loads(capsys.readouterr().out)["items"]]
    assert {("port", door.service, door.place) for door in doors(settings, rows)} <= set(items)
    assert {*rows, "supervisor"} <= {name for kind, name, _ in items if kind == "program"}
    assert {*settings.outside("interface").values()} <= {place for kind, _, place in items if kind == "line"}


@pytest.mark.parametrize(
    ("text", "host"),
    [
        ("10.0.0.2:14550", "10.0.0.2"),
        ("[fd00::2]:14550", "fd00::2"),
        ("192.168.1.0/24", "192.168.1.0/24"),
        ("192.168.1.2/24", "192.168.1.2/24"),
        ("tcp:192.168.53.2:2009", "192.168.53.2"),
        ("mqtts://broker.example.org:8883/fleet", "broker.example.org"),
        ("127.0.0.1:4747", ""),
        ("127.0.0.0/8", ""),
        ("0.0.0.0:80", ""),
        ("/dev/ttyS1", ""),
        ("canloop:can0", ""),
        ("12", ""),
        ("0A0", ""),
    ],
)
def test_a_value_names_a_host(text: str, host: str) -> None:
    assert _host(text) == host


@given(st.text(max_size=60))
def test_any_value_of_a_file_is_one_or_none(text: str) -> None:
    assert isinstance(_host(text), str)


def test_a_file_that_is_no_key_is_told_in_words(tmp_path: Path) -> None:
    for name in ("key", "certificate", "host_key"):
        (tmp_path / name).write_text("nothing of the kind")
        (tmp_path / name).chmod(0o600)
    tree = {"mavlink": {"key": str(tmp_path / "key")}, "ftpd": {"certificate": str(tmp_path / "certificate")}}
    tree |= {"sshd": {"host_key": str(tmp_path / "host_key")}}
    found = {item.name: item.what for item in inventory(config.load(ROOT / "etc/delfimx.toml"), tree) if item.kind == "key"}
    assert found["mavlink.key"].startswith("mode 0600; ")
    assert "not read" in found["ftpd.certificate"]
    assert "not read" in found["sshd.host_key"]

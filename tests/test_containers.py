"""The container: the recipe's steps and files, and what the compose file runs, run by an engine."""

import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from delfim import config
from delfim.__main__ import parsed
from delfim.canproxy.dsor import messages
from delfim.logging.candump import parse_line
from tests.guest import boat_image
from tests.guest.harness import PATH, ROOT, Guest, guest

DOCKERFILE, COMPOSE = ROOT / "docker" / "Dockerfile", ROOT / "docker" / "compose.yaml"
PODMAN = "podman --storage-driver=vfs --cgroup-manager=cgroupfs --events-backend=none"  # what works wherever it is run
pytestmark = pytest.mark.long
KNOWN = {"FROM", "RUN", "WORKDIR", "COPY", "ENV", "VOLUME", "STOPSIGNAL", "ENTRYPOINT", "CMD"}


def instructions() -> list[tuple[str, str]]:
    text = re.sub(r"\\\n\s*", "", re.sub(r"^#.*\n", "", DOCKERFILE.read_text(), flags=re.MULTILINE))
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in text.splitlines() if line)]


def test_it_is_a_dockerfile_that_ends_in_the_root_file_system_alone() -> None:
    steps = instructions()
    assert {word for word, _ in steps} <= KNOWN
    assert [rest for word, rest in steps if word == "FROM"] == ["debian:bookworm-slim AS build", "scratch"]
    last = steps[[rest for _, rest in steps].index("scratch") + 1 :]
    assert [rest for word, rest in last if word == "COPY"] == ["--from=build /image/root /"]
    assert not [rest for word, rest in last if word == "RUN"]  # there is no package manager to run
    entry, words = (json.loads(dict(last)[name]) for name in ("ENTRYPOINT", "CMD"))
    assert (entry, words[:2]) == (["delfim"], ["sim", "/etc/delfimx.toml"])


def test_its_shell_words_are_shell() -> None:
    for word, rest in instructions():
        if word == "RUN":
            subprocess.run(["sh", "-n", "-c", rest], check=True)


def test_the_context_holds_what_the_steps_name() -> None:
    kept = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    assert [name for name in kept if not (ROOT / name).exists()] == []
    named = re.findall(r"(?:requirements|docker)/[\w.]+", " ".join(rest for _, rest in instructions()))
    assert named
    assert [name for name in named if not (ROOT / name).is_file() or Path(name).parts[0] not in kept] == []


def composed() -> dict[str, Any]:
    services: dict[str, Any] = msgspec.yaml.decode(COMPOSE.read_bytes())["services"]
    return services


def test_what_is_run_are_commands_of_ours() -> None:
    root = dict(instructions())
    for words in (json.loads(root["CMD"]), *(service["command"] for service in composed().values())):
        _, asked = parsed([{"/etc/vehicle.toml": "/etc/delfimx.toml"}.get(word, word) for word in words])
        config.load(ROOT / asked.file.lstrip("/"), asked.set)


def test_the_services_are_built_from_the_dockerfile_and_need_no_device_of_the_computer() -> None:
    """A device that is not there keeps a container from starting."""
    for service in composed().values():
        assert (COMPOSE.parent / service["build"]["context"] / service["build"]["dockerfile"]).resolve() == DOCKERFILE
        assert service["read_only"]
        assert service["cap_drop"] == ["ALL"]
        assert "devices" not in service
    volumes = msgspec.yaml.decode(COMPOSE.read_bytes())["volumes"]
    sources = [each.partition(":")[0] for service in composed().values() for each in service["volumes"]]
    assert [source for source in sources if not source.startswith("/") and source not in volumes] == []


def podman(name: str, more: str = "") -> str:
    """Shell: what the compose file says of a service, for an engine, in the network of the guest; `more` are words for delfim.
    The root file system is that of the recipe's last stage; its environment and its first word are the recipe's."""
    service, steps = composed()[name], instructions()
    shared = [volume if volume.startswith("/") else f"/srv/{volume}" for volume in service["volumes"]]
    words = [*PODMAN.split(), "run", "--cgroups=disabled", "--network=host"]
    words += [f"--name={name}", "--read-only", *(f"--tmpfs={place}" for place in service["tmpfs"])]
    words += [f"--volume={volume}" for volume in shared]
    for option in ("cap_drop", "cap_add"):
        words += [f"--{option.replace('_', '-')}={each}" for each in service.get(option, [])]
    words += [f"--security-opt={each.removesuffix(':true')}" for each in service.get("security_opt", [])]
    words += [f"--env={each}" for word, rest in steps if word == "ENV" for each in rest.split()]
    words += ["--rootfs", str(boat_image.build() / "root"), *json.loads(dict(steps)["ENTRYPOINT"]), *service["command"]]
    return f"{shlex.join(words)} {more}"


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guest]:
    """A computer with a CAN bus and a container engine."""
    if reason := boat_image.missing():
        pytest.skip(reason)
    if not shutil.which("podman", path=PATH):
        pytest.skip("no container without podman (make system installs it on Debian)")
    with guest(tmp_path_factory.mktemp("engine"), memory_mib=640) as computer:
        computer.run("mount -t cgroup2 none /sys/fs/cgroup; mkdir -p /log /srv/simulated-log /var/lib/containers")
        # not what this machine has there
        computer.run("for place in /log /var/lib/containers; do mount -t tmpfs none $place; done")
        yield computer


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_simulation_sails_in_its_container(engine: Guest) -> None:
    result = engine.run(podman("simulation", "--for 3"), timeout_s=120.0)
    assert result.code == 0, result.output
    assert "delfim: time" in result.output


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_vehicle_sails_in_its_container_and_stops_in_order(engine: Guest) -> None:
    """As its owner's computer runs it: told to steer from beside it, looked at from outside, ended as `docker stop` does."""
    text = (ROOT / "etc/delfimx.toml").read_text().replace('interface = "can0"', 'interface = "vcan0"')
    (engine.folder / "boat.toml").write_text(text)
    look = "import urllib.request as r; print(r.urlopen('http://127.0.0.1:8080/metrics').read().decode())"
    again = "do kill -0 $vehicle; sleep 0.2; done 2>/dev/null"
    lines = [
        "set -e",
        "cp $FOLDER/boat.toml /etc/delfimx.toml",
        "python -m delfim nodes /etc/delfimx.toml >/dev/null 2>&1 & nodes=$!",
        f"{podman('vehicle')} >$FOLDER/vehicle 2>&1 & vehicle=$!",
        f"until {PODMAN} exec vehicle delfim drive /etc/vehicle.toml heading 150 1.2; {again}",
        f"until python -c {shlex.quote(look)}; {again}",
        "candump -L vcan0,040:7FE >$FOLDER/thrust & thrust=$!",
        "until grep -q ' 040#' $FOLDER/thrust; do sleep 0.1; done",
        f"{PODMAN} stop -t 30 vehicle",
        "wait $vehicle",
        "kill $thrust $nodes",
        "ls /log/*/state/*.state.gz",
    ]
    result = engine.run("\n".join(lines), timeout_s=120.0)
    said = (engine.folder / "vehicle").read_text()
    assert result.code == 0, result.output + said
    assert "delfim_up 1" in result.output
    assert "runtime: stopping: SIGTERM" in said
    frames = [parse_line(line)[1] for line in (engine.folder / "thrust").read_text().splitlines()]
    assert any(messages.unpack_propeller_command(frame.data).run for frame in frames)
    assert not messages.unpack_propeller_command(frames[-1].data).run

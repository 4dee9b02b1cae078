"""The container's recipe, as far as it can be held without an engine: its steps, its files, what it runs."""

import argparse
import json
import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import msgspec
import pytest

from delfim import config
from delfim.__main__ import _parser
from tests.guest import boat_image
from tests.guest.harness import ROOT, Guest

DOCKERFILE, COMPOSE = ROOT / "docker" / "Dockerfile", ROOT / "docker" / "compose.yaml"
PORTS = {"simulation.httpd": 'simulation.httpd="127.0.0.1:0"', "cantcpd.listen": 'cantcpd.listen=["127.0.0.1:0"]'}
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


def parsed(words: list[str]) -> argparse.Namespace:
    """Raises SystemExit for what is no command of ours."""
    return _parser().parse_args([{"/etc/vehicle.toml": "/etc/delfimx.toml"}.get(word, word) for word in words])


def test_what_is_run_are_commands_of_ours() -> None:
    root = dict(instructions())
    for words in (json.loads(root["CMD"]), *(service["command"] for service in composed().values())):
        asked = parsed(words)
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


@pytest.mark.timeout(900)
def test_the_simulation_sails_in_the_root_file_system(can_guest: Guest) -> None:
    """Where only it is there, as in a container: read-only but for /run, /tmp and /log."""
    if reason := boat_image.missing():
        pytest.skip(reason)
    root = boat_image.build() / "root"
    mounts = [f"mount -t tmpfs none {root}/{name}" for name in ("run", "tmp", "log")] + [f"mount -t proc none {root}/proc"]
    words = ["sim", "/etc/delfimx.toml", "--plain", "--for", "3", "--output", "/log"]
    ports = [word for name in ("simulation.httpd", "cantcpd.listen") for word in ("--set", PORTS[name])]
    sail = shlex.join(["chroot", str(root), "/usr/bin/env", "-i", "PATH=/usr/sbin:/usr/bin", "delfim", *words, *ports])
    result = can_guest.run(f"unshare -m sh -ec {shlex.quote('; '.join([*mounts, f'exec {sail}']))}", timeout_s=90.0)
    assert result.code == 0, result.output

"""A certificate for tests of several daemons."""

import subprocess
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of 127.0.0.1, by itself, with its key."""
    place = tmp_path_factory.mktemp("certificate")
    words = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -subj /CN=boat -days 2"
    more = ("-addext", "subjectAltName=IP:127.0.0.1", "-keyout", place / "key", "-out", place / "cert")
    subprocess.run([*words.split(), *more], check=True, capture_output=True)
    pem = place / "boat.pem"
    pem.write_text((place / "cert").read_text() + (place / "key").read_text())
    return pem

"""The boat's CAN interfaces as its first process sets them up, with a program in place of ip(8) that writes down its words."""

from pathlib import Path

import pytest

from delfim.services.can import buses

IP = """#!/bin/sh
echo "$*" >>"$0.said"
case $* in *can7*) echo "Cannot find device" >&2; exit 1 ;; esac
"""


@pytest.fixture
def said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "ip").write_text(IP)
    (tmp_path / "ip").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setattr(buses, "LATE_S", 0.0)
    return tmp_path / "ip.said"


def test_each_bus_has_its_bit_rate_restarts_after_bus_off_and_is_up(said: Path) -> None:
    buses.bring_up({"can0": 500_000, "can1": 250_000, "vcan0": 500_000})
    assert said.read_text().splitlines() == [
        "link set can0 type can bitrate 500000 restart-ms 100",
        "link set can0 up",
        "link set can1 type can bitrate 250000 restart-ms 100",
        "link set can1 up",
        "link add vcan0 type vcan",
        "link set vcan0 up",
    ]


def test_a_bus_that_is_not_there_is_reported_and_the_others_are_set_up(said: Path, caplog: pytest.LogCaptureFixture) -> None:
    buses.bring_up({"can7": 500_000, "can0": 500_000})
    assert "link set can0 up" in said.read_text()
    assert "ip link set can7 up: Cannot find device" in caplog.text


def test_a_computer_without_ip_starts_all_the_same(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setenv("PATH", "/nonexistent")
    buses.bring_up({"vcan0": 500_000})
    assert "CAN: ip: No such file or directory" in caplog.text

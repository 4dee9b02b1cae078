"""The supervisor's own ways to motors, bus, pins and the hardware watchdog. What is at their ends is played."""

import contextlib
import logging
from types import SimpleNamespace
from typing import Any

import pytest

from delfim.base.errors import DelfimError
from delfim.canproxy.dsor.messages import SHUTDOWN_ACKNOWLEDGE, ShutdownAcknowledge, ShutdownStage, pack_shutdown_acknowledge
from delfim.canproxy.socket import CanAddress
from delfim.lines import opening
from delfim.services.supervision import stop, watchdog
from delfim.services.supervision.stop import CutOff, PropellerStop, opened_driver
from delfim.services.supervision.watchdog import Watchdog


class Ends:
    """Drivers and a bus; what is done with them, in words. Those in `fails` fail so."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.told, self.fails = list[Any](), dict[str, Exception]()
        self.settings: Any = SimpleNamespace(drivers=("left", "right"), aboard=(), can=SimpleNamespace(interface="can7"))
        monkeypatch.setattr(stop.actuators, "module", lambda name, settings: self.does(f"import {name}"))
        monkeypatch.setattr(stop, "opened_driver", self.driver)
        monkeypatch.setattr(stop, "open_can", self.bus)

    def does(self, what: Any) -> None:
        self.told.append(what)
        if isinstance(what, str) and what in self.fails:
            raise self.fails[what]

    def driver(self, settings: object, name: str) -> tuple[Any, contextlib.ExitStack]:
        assert settings is self.settings
        self.does(f"open {name}")
        links = contextlib.ExitStack()
        links.callback(self.does, f"close {name}")
        return SimpleNamespace(stop=lambda: self.does(f"stop {name}")), links

    def bus(self, interface: str) -> Any:
        self.does(f"open {interface}")
        return SimpleNamespace(
            setblocking=lambda blocking: self.does(("blocks", blocking)),
            sendto=lambda *frame: self.does(frame),
            close=lambda: self.does("close bus"),
        )

    def since(self) -> list[Any]:
        """What was told since this was asked last."""
        told, self.told = self.told, []
        return told


@pytest.fixture
def ends(monkeypatch: pytest.MonkeyPatch) -> Ends:
    return Ends(monkeypatch)


def test_drivers_are_loaded_beforehand_opened_when_needed_and_kept(ends: Ends) -> None:
    propellers = PropellerStop(ends.settings)
    assert ends.since() == ["import left", "import right"]
    propellers()
    assert ends.since() == ["open left", "stop left", "open right", "stop right"]
    propellers()
    assert ends.since() == ["stop left", "stop right"]
    propellers.close()
    assert ends.since() == ["close left", "close right"]
    propellers()
    assert ends.since() == ["open left", "stop left", "open right", "stop right"]


def test_one_that_cannot_be_told_is_opened_anew_and_keeps_the_others_from_nothing(ends: Ends) -> None:
    propellers = PropellerStop(ends.settings)
    ends.fails = {"stop left": OSError(5, "Remote I/O error"), "open right": DelfimError("no such line")}
    ends.since()
    with pytest.raises(DelfimError, match=r"^Remote I/O error; no such line$"):
        propellers()
    assert ends.since() == ["open left", "stop left", "close left", "open right"]
    ends.fails = {}
    propellers()
    assert ends.since() == ["open left", "stop left", "open right", "stop right"]


@pytest.mark.parametrize(("is_safe", "stage"), [(True, ShutdownStage.SAFE), (False, ShutdownStage.HELD)])
def test_at_the_end_the_bus_is_told_whatever_the_motors_say(ends: Ends, is_safe: bool, stage: ShutdownStage) -> None:
    propellers = PropellerStop(ends.settings)
    ends.fails = {"stop right": OSError(5, "Remote I/O error")}
    ends.since()
    propellers.tell(is_safe, ["sshd", "ftpd"])
    frame = pack_shutdown_acknowledge(ShutdownAcknowledge(stage, 2)), CanAddress(SHUTDOWN_ACKNOWLEDGE)
    stopped = ["open left", "stop left", "open right", "stop right", "close right"]
    assert ends.since() == [*stopped, "open can7", ("blocks", False), frame]
    propellers.tell(is_safe, ["sshd", "ftpd"])
    assert ends.since() == ["stop left", *stopped[2:], frame]
    propellers.close()
    assert ends.since() == ["close left", "close bus"]
    ends.fails["open can7"] = OSError(19, "No such device")
    propellers.tell(is_safe, [])
    propellers.close()
    assert ends.since() == [*stopped, "open can7", "close left"]


@pytest.mark.parametrize("fails", [False, True])
def test_the_links_of_a_driver_are_its_own_and_closed_with_it(monkeypatch: pytest.MonkeyPatch, fails: bool) -> None:
    told = list[Any]()

    @contextlib.contextmanager
    def bound(*how: object) -> Any:
        told.append(how)
        try:
            yield "bus"
        finally:
            told.append("bus closed")

    def line(*how: object) -> Any:
        told.append((*how[:2], how[5]))
        return SimpleNamespace(close=lambda: told.append("line closed"))

    def opened(name: str, settings: object, links: Any) -> str:
        assert links.bus("can0", (1, 2)) == "bus"
        links.line("/dev/x", 9600)
        links.line("/dev/y", 1, "8E2").close()
        if fails:
            raise DelfimError("no motor")
        return f"{name} of {settings.can}"

    monkeypatch.setattr(opening, "open_bound", bound)
    monkeypatch.setattr(opening, "SerialLine", line)
    monkeypatch.setattr(stop.actuators, "open_actuator", opened)
    settings: Any = SimpleNamespace(can="the bus")
    expected = [("the bus", "can0", (1, 2)), ("/dev/x", 9600, "8N1"), ("/dev/y", 1, "8E2"), "line closed"]
    if fails:
        with pytest.raises(DelfimError, match="no motor"):
            opened_driver(settings, "left")
    else:
        driver, links = opened_driver(settings, "left")
        assert (driver, told) == ("left of the bus", expected)
        links.close()
    assert told == [*expected, "line closed", "line closed", "bus closed"]


@pytest.mark.parametrize(("at", "high_when_off"), [("high", True), ("low", False)])
def test_the_cut_is_held_from_the_start_and_says_what_it_did(monkeypatch, at, high_when_off):
    told, fails = list[Any](), list[OSError]()

    def put(high: bool) -> None:
        told.append(high)
        if fails:
            raise fails[0]

    output = SimpleNamespace(put=put, close=lambda: told.append("closed"))
    monkeypatch.setattr(stop, "open_output", lambda *how: (told.append(how), output)[1])
    cut = CutOff("/dev/gpiochip0", "RELAY", at == "high")
    assert told == [("/dev/gpiochip0", "RELAY", not high_when_off)]
    assert [cut(True), cut(False)] == ["RELAY cut them off", "RELAY lets them turn again"]
    assert told[1:] == [high_when_off, not high_when_off]
    fails.append(OSError(5, "Input/output error"))
    assert cut(True) == "pwm.cut: RELAY: Input/output error; use the kill switch"
    cut.close()
    assert told[-1] == "closed"


def test_a_cut_that_there_is_not_says_so(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    def refuse(*how: object) -> None:
        raise DelfimError("no line RELAY")

    monkeypatch.setattr(stop, "open_output", refuse)
    none = CutOff("", "", True)
    assert none(True) == none(False) == "the boat has no pwm.cut; use the kill switch"
    assert not caplog.records
    broken = CutOff("/dev/gpiochip0", "RELAY", True)
    assert broken(True) == "pwm.cut: no line RELAY"
    assert caplog.messages == ["pwm.cut: no line RELAY; nothing aboard can cut off the motors"]
    for each in (none, broken):
        each.close()


class Devices:
    """In the place of os: a watchdog as file 0, for who starts a program without standard input; another is in use."""

    O_WRONLY = 1
    path = SimpleNamespace(exists=lambda device: device != "/dev/none")

    def __init__(self) -> None:
        self.written, self.fails = list[Any](), False

    def open(self, device: str, flags: int) -> int:
        assert flags == self.O_WRONLY
        if device == "/dev/used":
            raise OSError(16, "Device or resource busy")
        return 0

    def write(self, fd: int, word: bytes) -> None:
        if self.fails:
            raise OSError(19, "No such device")
        self.written.append((fd, word))


def test_a_hardware_watchdog_is_stroked_until_it_fails(monkeypatch, caplog):
    devices = Devices()
    monkeypatch.setattr(watchdog, "os", devices)
    for absent in ("", "/dev/none"):
        Watchdog(absent).stroke(b"V")
    assert (devices.written, caplog.messages) == ([], [])
    Watchdog("/dev/used").stroke(b"V")
    assert (devices.written, caplog.messages) == ([], ["/dev/used: Device or resource busy; going on without it"])
    dog = Watchdog("/dev/watchdog")
    dog.stroke(b"\0")
    devices.fails = True
    dog.stroke(b"\0")
    devices.fails = False
    dog.stroke(b"V")
    assert devices.written == [(0, b"\0")]
    assert caplog.messages[1:] == ["hardware watchdog: No such device; going on without it"]
    assert {record.levelno for record in caplog.records} == {logging.ERROR}

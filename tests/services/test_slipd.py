"""slipd through its ups and downs, on pseudo-terminals and a clock of the test's own. The kernel's SLIP and the TUN device are
met in tests/guest/test_guest_slip.py."""

import os
import pty
from collections.abc import Iterator
from pathlib import Path

import pytest

from delfim.base.clock import ManualClock
from delfim.services.radio.slipd import SerialRadio, carrier_source
from delfim.services.tables import Slipd


class FakeLine:
    """Stands in for the kernel's line, which needs a kernel of our own."""

    name = "sl9"

    def __init__(self) -> None:
        self.why = self.hush = ""
        self.closed = False
        self.attended = 0

    def attend(self) -> None:
        self.attended += 1

    def trouble(self) -> str:
        return self.why

    def silence(self) -> str:
        return self.hush

    def close(self) -> None:
        self.closed = True


class Bench:
    def __init__(self, tmp_path: Path) -> None:
        self.master, slave = pty.openpty()
        self.carrier = tmp_path / "carrier"
        self.carrier.write_text("1")
        self.device = os.ttyname(slave)
        os.close(slave)
        self.settings = Slipd(device=self.device, carrier=f"file:{self.carrier}")
        self.clock, self.lines, self.refusal = ManualClock(), list[FakeLine](), ""
        self.radio = SerialRadio(self.settings, self.clock, self.open_line)

    def open_line(self, port: int) -> FakeLine:
        if self.refusal:
            raise OSError(1, self.refusal)
        self.lines.append(FakeLine())
        return self.lines[-1]

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.25)):
            if self.radio.is_due():
                self.radio.retry()
                self.radio.attend()
            self.clock.advance(0.25)

    def state(self) -> tuple[object, object]:
        report = self.radio.report()
        return report["state"], report["reason"]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.radio.close()
    os.close(bench.master)


def test_it_comes_up_and_stays(bench: Bench) -> None:
    bench.run(10.0)
    assert bench.state() == ("up", "up")
    assert [line.attended for line in bench.lines] == [1]


def test_a_line_that_carries_nothing_says_why_and_stays_up(bench: Bench) -> None:
    bench.run(1.0)
    bench.lines[0].hush = "no poll for station 1"
    bench.run(1.0)
    assert bench.state() == ("up", "no poll for station 1")
    bench.lines[0].hush = ""
    bench.run(1.0)
    assert (bench.state(), bench.radio.report()["losses"], len(bench.lines)) == (("up", "up"), 0, 1)


def test_without_carrier_it_waits_and_comes_up_soon_after(bench: Bench) -> None:
    bench.carrier.write_text("0")
    bench.run(60.0)
    assert bench.state() == ("down", "no carrier")
    bench.carrier.write_text("1")
    bench.run(2.25)
    assert bench.state() == ("up", "up")


@pytest.mark.parametrize("how", ["carrier", "line"])
def test_what_was_lost_is_built_anew_within_five_seconds(bench: Bench, how: str) -> None:
    bench.run(5.0)
    if how == "carrier":
        bench.carrier.write_text("0")
    else:
        bench.lines[0].why = "the line was hung up"
    bench.run(0.25)
    assert bench.state() == ("down", "lost: no carrier" if how == "carrier" else "lost: the line was hung up")
    assert bench.lines[0].closed
    bench.run(30.0)
    bench.carrier.write_text("1")
    bench.run(4.75)
    assert bench.state() == ("up", "up")
    assert bench.radio.report()["losses"] == 1


def test_a_refusal_of_the_kernel_is_told_and_tried_again(bench: Bench) -> None:
    bench.refusal = "Operation not permitted"
    bench.run(10.0)
    assert bench.state() == ("down", "Operation not permitted")
    bench.refusal = ""
    bench.run(2.25)
    assert bench.state() == ("up", "up")


def test_an_adapter_that_is_not_there_is_told_and_its_descriptors_are_not_kept(bench: Bench) -> None:
    radio = SerialRadio(Slipd(device="/dev/no-such-port"), bench.clock, bench.open_line)
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(100):
        if radio.is_due():
            radio.retry()
        bench.clock.advance(0.25)
    assert radio.report()["reason"] == "No such file or directory"
    assert len(os.listdir("/proc/self/fd")) == before


def test_carriers() -> None:
    assert carrier_source("none")(0)
    assert not carrier_source("file:/no/such/file")(0)
    with pytest.raises(OSError), open(os.devnull) as null:  # noqa: PT011
        carrier_source("dcd")(null.fileno())

"""`delfim can stat`: the load of a bus by identifier, the state of its controller, and lost frames."""

import argparse
import contextlib
import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

from delfim.base.errors import ConfigError
from delfim.base.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame, identifier
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanSocket, bus_state

BITRATE: Final = 1_000_000
IDENTIFIERS_MAX: Final = 4096  # told apart; beyond, they count for the bus only
LINK_S: Final = 1.0  # that ip(8) may take


_POLYNOMIAL: Final = 0x4599  # CRC-15, without its highest bit
_UNSTUFFED_BITS: Final = 13  # CRC delimiter, acknowledge slot and its delimiter, end of frame (7), interframe space (3)
# After five equal bits a bit of the other kind is stuffed in, and counts with the bits that follow it.
_STUFFED: Final = re.compile("0{5}(?:1{4}0{4})*(?:1{4})?|1{5}(?:0{4}1{4})*(?:0{4})?")


def _crc_of_byte(byte: int) -> int:
    crc = byte << 7
    for _ in range(8):
        crc = (crc << 1 ^ (_POLYNOMIAL if crc & 0x4000 else 0)) & 0x7FFF
    return crc


_CRC: Final = tuple(map(_crc_of_byte, range(256)))


def frame_bits(frame: Frame) -> int:
    """Bits from the start of the frame to the end of the interframe space. An error frame was never on the bus: 0."""
    arb, data = frame.arb, frame.data
    if arb & CAN_ERR:
        return 0
    remote = bool(arb & CAN_RTR)
    if arb & CAN_IDE:  # start, 11 bits, SRR and IDE recessive, 18 bits, RTR, r1, r0, length
        head, length = (arb >> 21) << 27 | 0b11 << 25 | (arb >> 3 & 0x3FFFF) << 7 | remote << 6 | len(data), 39
    else:  # start, 11 bits, RTR, IDE, r0, length
        head, length = (arb >> 21) << 7 | remote << 6 | len(data), 19
    body = head if remote else head << 8 * len(data) | int.from_bytes(data, "big")
    length += 0 if remote else 8 * len(data)
    crc = 0
    for byte in body.to_bytes(13, "big"):  # zeros in front do not change it
        crc = (crc << 8 ^ _CRC[(crc >> 7 ^ byte) & 0xFF]) & 0x7FFF
    bits = f"{body << 15 | crc:0{length + 15}b}"
    stuffed = sum(1 + (len(run) - 5) // 4 for run in _STUFFED.findall(bits))
    return len(bits) + stuffed + _UNSTUFFED_BITS


@dataclass(slots=True)
class IdentifierRow:
    """One identifier."""

    total: int = 0
    frames: int = 0  # in this interval, as the bits
    bits: int = 0
    data: bytes = b""  # the newest


@dataclass(slots=True)
class Statistics:
    """The counts of a bus. `report` ends an interval."""

    rows: dict[int, IdentifierRow] = field(default_factory=dict)
    frames: int = 0
    bits: int = 0
    total: int = 0
    error_frames: int = 0
    state: str = ""  # of the controller, as its last error frame says
    transmit_errors: int | None = None
    receive_errors: int | None = None

    def add(self, frame: Frame) -> None:
        if frame.arb & CAN_ERR:
            self.error_frames += 1
            if state := bus_state(frame):
                self.state, self.transmit_errors, self.receive_errors = state
            return
        bits = frame_bits(frame)
        self.frames += 1
        self.bits += bits
        self.total += 1
        row = self.rows.get(frame.arb)
        if row is None:
            if len(self.rows) >= IDENTIFIERS_MAX:
                return
            row = self.rows[frame.arb] = IdentifierRow()
        row.total += 1
        row.frames += 1
        row.bits += bits
        row.data = frame.data

    def report(self, elapsed_s: float, bitrate: int, dropped: int, link: dict[str, Any]) -> dict[str, Any]:
        """JSON-ready; rates and loads are those since the report before. `link` is the kernel's state of the controller."""
        room_bits = bitrate * elapsed_s
        rows = [
            {
                "id": f"{identifier(arb):08X}" if arb & CAN_IDE else f"{identifier(arb):03X}",
                "rate_hz": row.frames / elapsed_s,
                "load_percent": 100 * row.bits / room_bits,
                "total": row.total,
                "data": row.data.hex().upper(),
            }
            for arb, row in sorted(self.rows.items())
        ]
        report = {
            "bitrate": bitrate,
            "rate_hz": self.frames / elapsed_s,
            "load_percent": 100 * self.bits / room_bits,
            "total": self.total,
            "dropped": dropped,
            "error_frames": self.error_frames,
            "state": self.state,
            "transmit_errors": self.transmit_errors,
            "receive_errors": self.receive_errors,
            **link,
            "identifiers": rows,
        }
        self.frames = self.bits = 0
        for row in self.rows.values():
            row.frames = row.bits = 0
        return report


def parse_link(text: str) -> dict[str, Any]:
    """The CAN controller in the output of `ip -details -statistics -json link show`; empty if it has none."""
    try:
        (link,) = json.loads(text)
        info = link["linkinfo"]
        data, counts = info.get("info_data", {}), info.get("info_xstats", {})
        counters = data.get("berr_counter", {})
        received, sent = link["stats64"]["rx"], link["stats64"]["tx"]
        told = {
            "bitrate": data.get("bittiming", {}).get("bitrate"),
            "state": data["state"].lower().replace("-", " ") if "state" in data else None,
            "transmit_errors": counters.get("tx"),
            "receive_errors": counters.get("rx"),
            "bus_errors": counts.get("bus_error"),
            "bus_off": counts.get("bus_off"),
            "restarts": counts.get("restarts"),
            "interface_dropped": received["dropped"] + received.get("over_errors", 0) + sent["dropped"],
        }
    except (ValueError, KeyError, TypeError, AttributeError):
        return {}
    return {name: value for name, value in told.items() if value is not None}


def link_of(interface: str) -> dict[str, Any]:
    """The kernel's state of an interface; empty for a bus that is no interface of this computer."""
    if ":" in interface or interface == "any":
        return {}
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):
        command = ["ip", "-details", "-statistics", "-json", "link", "show", interface]
        return parse_link(subprocess.run(command, capture_output=True, text=True, timeout=LINK_S).stdout)
    return {}


def lines(name: str, report: dict[str, Any]) -> Iterator[str]:
    """A report for people."""
    drops = report["dropped"] + report.get("interface_dropped", 0)
    yield (
        f"{name}  load {report['load_percent']:.1f} % of {report['bitrate'] / 1000:g} kbit/s  {report['rate_hz']:.0f} frames/s"
        f"  total {report['total']}  dropped {drops}"
    )
    known = ("error_frames", "state", "transmit_errors", "receive_errors", "bus_errors", "bus_off", "restarts")
    errors = (f"{key.replace('_', ' ')} {report[key]}" for key in known if report.get(key) not in (None, ""))
    yield "  " + "  ".join(errors)
    yield f"  {'ID':8}  {'rate/s':>8}  {'load %':>6}  {'total':>9}  data"
    for row in report["identifiers"]:
        yield f"  {row['id']:>8}  {row['rate_hz']:8.1f}  {row['load_percent']:6.2f}  {row['total']:9}  {row['data']}"


def stat(asked: argparse.Namespace) -> int:
    """The command."""
    if asked.interval_s <= 0 or (asked.bitrate is not None and asked.bitrate <= 0):
        raise ConfigError("delfim can stat", "-i, --bitrate", "must be more than 0")
    with open_can(asked.bus, error_frames=True) as can:
        can.bind(ANYTHING)
        statistics = Statistics()
        began_s, number = time.monotonic(), 0
        while asked.count is None or number < asked.count:
            number += 1
            _collect(can, statistics, began_s + asked.interval_s)
            link = link_of(asked.bus)
            bitrate = asked.bitrate or link.pop("bitrate", None) or BITRATE
            now_s = time.monotonic()
            report = statistics.report(now_s - began_s, bitrate, can.dropped, {**link, "bitrate": bitrate})
            began_s = now_s
            if asked.json:
                print(json.dumps({"bus": asked.bus, **report}), flush=True)
            else:
                clear = "\x1b[H\x1b[J" if sys.stdout.isatty() else ""
                print(clear + "\n".join(lines(asked.bus, report)), flush=True)
    return 0


def _collect(can: CanSocket, statistics: Statistics, until_s: float) -> None:
    """Counts every frame until then."""
    while (left_s := until_s - time.monotonic()) > 0:
        can.settimeout(left_s)
        with contextlib.suppress(TimeoutError):
            statistics.add(can.recvmsg())


def add_parser(tools: "argparse._SubParsersAction[argparse.ArgumentParser]", bus: str) -> None:
    text = "Load, rates of each identifier, error counters and drops, once each interval."
    one = tools.add_parser("stat", help="load, rates, errors, drops", description=text)
    one.set_defaults(run=stat)
    one.add_argument("bus", metavar="BUS", help=bus)
    one.add_argument(
        "-b", "--bitrate", type=int, metavar="BIT/S", help=f"of the bus, where the kernel does not know ({BITRATE})"
    )
    one.add_argument("-i", dest="interval_s", type=float, default=1.0, metavar="SECONDS", help="interval (%(default)g)")
    one.add_argument("-n", dest="count", type=int, metavar="COUNT", help="end after so many intervals")
    one.add_argument("--json", action="store_true", help="one JSON object an interval")

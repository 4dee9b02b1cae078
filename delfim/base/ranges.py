"""Kinds of values in a vehicle's file: each has its range, or a pattern and the words for a person whose value is refused."""

from ipaddress import ip_address
from typing import Annotated, Literal

import msgspec

from delfim.base.tables import text

PORT = "([0-9]{1,4}|[1-5][0-9]{4}|6[0-4][0-9]{3}|65[0-4][0-9]{2}|655[0-2][0-9]|6553[0-5])"  # 0 to 65535
PLACE = "/[^ ]+( +[^ ]+)*"  # of a file or a device: the folders of people have blanks in their names
Name = Annotated[str, text("[A-Za-z][A-Za-z0-9_-]{0,31}", "a letter, then up to 31 letters, digits, _ or -")]
Fraction = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
BatteryVoltage = Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)]
Seconds = Annotated[float, msgspec.Meta(ge=0.001, le=3600.0)]
ValueName = Annotated[
    str,
    text(
        r"([A-Za-z][A-Za-z0-9_-]{0,31}\.)?[A-Za-z][A-Za-z0-9_]{0,31}",
        "a sensor's value, as depth_m, or PAYLOAD.NAME of a payload program",
    ),
]
Bounds = Annotated[dict[ValueName, Annotated[float, msgspec.Meta(ge=-1e15, le=1e15)]], msgspec.Meta(max_length=16)]
Moment = Annotated[float, msgspec.Meta(ge=0.1, le=3600.0)]  # s: not below the period of the watchdog
Metres = Annotated[float, msgspec.Meta(ge=0.01, le=10_000.0)]
Speed = Annotated[float, msgspec.Meta(ge=0.05, le=30.0)]  # m/s: a slower boat does not move, and says that it does
Interface = Annotated[
    str,
    text(
        "([a-z][a-z0-9_.-]{0,14}|canloop:[A-Za-z0-9_.-]{1,32}|python-can:[^ ]+)",
        "a Linux interface as can0, canloop:NAME, or python-can:INTERFACE:CHANNEL[@BITRATE]",
    ),
]
Degrees = Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]
MicroTesla = Annotated[float, msgspec.Meta(ge=-500.0, le=500.0)]
Stretch = Annotated[float, msgspec.Meta(ge=0.5, le=2.0)]
Shear = Annotated[float, msgspec.Meta(ge=-0.2, le=0.2)]
Device = Annotated[
    str,
    text(
        rf"({PLACE}|tcp:([0-9.]+|\[[0-9A-Fa-f:]+\]):{PORT})", "a serial port as /dev/ttyUSB0, or tcp:ADDRESS:PORT, in numbers"
    ),
]
Baud = Annotated[int, msgspec.Meta(ge=1200, le=4_000_000)]
DsorNode = Annotated[int, msgspec.Meta(ge=0, le=126)]
BitRate = Annotated[int, msgspec.Meta(ge=10_000, le=1_000_000)]
Endpoint = Annotated[str, text(rf"[^ :]+:{PORT}", "ADDRESS:PORT, port 0 to 65535")]
Listen = Annotated[str, text(rf"([^ :]+|\[[0-9A-Fa-f:.]+\]):{PORT}", "ADDRESS:PORT or [IPv6]:PORT, port 0 to 65535")]
Listeners = Annotated[tuple[Listen, ...], msgspec.Meta(min_length=1, max_length=8)]
Ports = Annotated[tuple[Listen, ...], msgspec.Meta(max_length=8)]
LinuxInterface = Annotated[str, text("[^ /:]{1,15}", "a Linux interface")]
MountPoint = Annotated[str, text(r"(/[^/\x00]+)*", "an absolute path, or empty")]
Megabytes = Annotated[int, msgspec.Meta(ge=0, le=1 << 20)]
Network = Annotated[str, text("[0-9A-Fa-f:.]+(/[0-9]{1,3})?", "an IP address, or ADDRESS/BITS")]
PayloadRight = Literal["hold", "goto", "speed", "heading", "mission", "obstacles", "samples", "values"]  # of a payload program
ShownName = Annotated[str, text("[a-z][a-z0-9_]{0,9}", "a small letter, then up to 9 small letters, digits or _")]  # as water_c
NETWORKED = ("udp:", "tcp:", "tcp-listen:", "gpsd:")  # devices that are none of this computer's
DeviceName = Annotated[str, text("[a-z][a-z0-9_.-]{0,14}", "a small letter, then up to 14 small letters, digits, _, . or -")]


def address(text: str) -> tuple[str, int]:
    """Split an `Endpoint` or a `Listen` into host and port."""
    host, _, port = text.rpartition(":")
    return host.strip("[]"), int(port)


def is_loopback(text: str) -> bool:
    """Whether only this computer reaches an `Endpoint` or a `Listen`."""
    host = address(text)[0]
    try:
        return ip_address(host).is_loopback
    except ValueError:  # a name
        return host == "localhost"

"""A boat with a pair of u-blox receivers, a caster that is cut, and a console that sends corrections instead.

The receivers are played, in UBX made by pyubx2: their fix and the age of their corrections follow from what reaches their port.
"""

import contextlib
import json
import math
import os
import socket
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest

from delfim.canproxy.dsor.messages import Navigation
from delfim.lines.rtcm import RtcmFrames, framed
from delfim.parts.mavlink.codec.wire import Sender, dialect
from tests.parts.gnss.caster import casting, free_port, needs_str2str
from tests.parts.nmea0183.receiver import MOVING, message, pvt
from tests.parts.nmea0183.test_nmea0183_afloat import Pty, at_sea, port

BASE = framed((1005 << 4).to_bytes(2, "big") + bytes(17))
OBSERVED = framed((1077 << 4).to_bytes(2, "big") + bytes(300))
AGES = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0)  # s, of the codes from 1 on


class Receiver:
    """A u-blox with RTK: fixed while its corrections are fresh."""

    def __init__(self, port: Pty) -> None:
        self._port, self._stream, self._corrected_s = port, RtcmFrames(), -1e9

    def say(self, n: Navigation) -> None:
        with contextlib.suppress(BlockingIOError, OSError):
            if self._stream.feed(os.read(self._port._end, 1 << 16)):
                self._corrected_s = time.monotonic()
        age_s = time.monotonic() - self._corrected_s
        code = next((code for code, most_s in enumerate(AGES, 1) if age_s <= most_s), 0)
        at = datetime.fromtimestamp(n.utc_ns // 1_000_000_000, UTC)
        told = {"year": at.year, "month": at.month, "day": at.day, "hour": at.hour, "min": at.minute, "second": at.second}
        told |= {"nano": n.utc_ns % 1_000_000_000, "iTOW": n.utc_ns // 1_000_000 % 604_800_000}
        told |= {"lat": math.degrees(n.latitude_rad or 0.0), "lon": math.degrees(n.longitude_rad or 0.0)}
        told |= {"velN": round(1000 * (n.north_mps or 0.0)), "velE": round(1000 * (n.east_mps or 0.0))}
        good = {"carrSoln": 2, "hAcc": 14} if code else {"carrSoln": 0, "hAcc": 1500}
        self._port.say(pvt(**told, **good, diffSoln=int(code > 0), lastCorrectionAge=code))


def shown(tmp_path: Path) -> dict[str, object]:
    """The corrections' own figures."""
    with contextlib.suppress(OSError, ValueError):
        return dict(json.loads((tmp_path / "service-corrections.json").read_text())["figures"])
    return {}


def values(tmp_path: Path, base: Pty, rover: Pty, caster_port: int, boat_port: int) -> tuple[str, ...]:
    """Of the vehicle's file."""
    secret = tmp_path / "ntrip"
    secret.write_text("ana:secret\n")
    secret.chmod(0o600)
    return (
        *port("base", base.name),
        *port("rover", rover.name),
        "nmea0183.ports.rover.baseline_m=1.5",
        "nmea0183.ports.rover.baseline_deg=90.0",
        "navigation.estimator=true",
        "failsafe.console_silent.after_s=600.0",
        "failsafe.gnss_poor={corrections_s=5.0, accuracy_m=0.1, after_s=1.0, heading='hold'}",
        'corrections.to="base"',
        f'corrections.caster="ntrip://127.0.0.1:{caster_port}/BASE"',
        f'corrections.credentials="{secret}"',
        "mavlink.enabled=true",
        f'mavlink.listen="127.0.0.1:{boat_port}"',
    )


@needs_str2str
@pytest.mark.long
def test_a_boat_holds_when_its_corrections_grow_old_and_the_radio_brings_others(tmp_path):
    base_port, rover_port = Pty(tmp_path / "base"), Pty(tmp_path / "rover")
    receiver, caster_port, boat_port = Receiver(base_port), free_port(), free_port()
    sender, more = Sender(250, 190, None, lambda: 0), values(tmp_path, base_port, rover_port, caster_port, boat_port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as console, contextlib.ExitStack() as links:
        caster = links.enter_context(casting(caster_port))
        speaks = [lambda: caster.say(BASE + OBSERVED)]

        def say(n: Navigation) -> None:
            for each in speaks:
                each()
            heading_deg = (math.degrees(n.heading_rad or 0.0) + 90.0) % 360.0
            told = {"version": 1, "relPosHeading": heading_deg, "relPosLength": 151, "accHeading": 0.4}
            rover_port.say(message("NAV-RELPOSNED", **(told | MOVING)))
            receiver.say(n)

        def by_radio() -> None:
            for data in (OBSERVED[:180], OBSERVED[180:]):
                words = dialect.MAVLink_gps_rtcm_data_message(1, len(data), [*data, *bytes(180 - len(data))])
                console.sendto(sender.pack(words), ("127.0.0.1", boat_port))

        with at_sea(tmp_path, say, *more) as sea:
            state = sea.until(lambda s: s["fix"] == 5 and s["corrections_s"] == 1.0)
            assert state["accuracy_m"] == pytest.approx(0.014)
            kinds = {name: kind["talker"] for name, kind in state["nmea0183"]["kinds"].items()}
            assert (kinds["position"], kinds["heading"]) == ("base:UB", "rover:UB")
            line = next(each for each in state["checks"] if each["name"] == "gnss")
            assert line == {
                "name": "gnss",
                "ok": True,
                "reason": "RTK, 20 satellites, accuracy 0.01 m, corrections 1 s old",
            }
            sea.sail("heading", heading_deg=90.0, speed_mps=1.0)
            sea.until(lambda s: s["speed_mps"] and s["speed_mps"] > 0.7 and abs(s["heading_deg"] - 90.0) < 10.0)

            speaks.clear()
            links.close()
            state = sea.until(lambda s: s["mode"] == "hold")
            assert state["reason"] == "satellite navigation poor: corrections 10 s old"
            sea.until(lambda s: "caster" in shown(tmp_path)["troubles"])

            speaks.append(by_radio)
            state = sea.until(lambda s: s["corrections_s"] == 1.0)
            assert state["mode"] == "hold", "the operator says when it goes on"
            assert state["mavlink"]["counts"]["corrections"] > 1
            assert shown(tmp_path)["radio"]["messages"]["1077"] >= 1

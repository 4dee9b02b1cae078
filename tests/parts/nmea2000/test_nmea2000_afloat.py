"""A boat in the real runtime is a device of its NMEA 2000 bus: an independent decoder sees its name and where it is, a display
asks it, and another device takes its address.
"""

import logging
import os
import time

import pytest
from nmea2000.decoder import NMEA2000Decoder

from delfim.canproxy.nmea2000.device import FIRST
from delfim.canproxy.nmea2000.parcels import CLAIM, PRODUCT, REQUEST, Parcel, frames
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanAddress
from delfim.vehicle.operator.link import Link
from tests.afloat import running

PATIENCE_S = 200.0
DISPLAY = 7
logging.getLogger("nmea2000").setLevel(logging.ERROR)


class Display:
    """A device that decodes all it hears."""

    def __init__(self, bus):
        self.bus, self._decoder = bus, NMEA2000Decoder()
        bus.bind(ANYTHING)
        bus.settimeout(PATIENCE_S)

    def say(self, parcel):
        for arb, data in frames(parcel, 0):
            self.bus.sendto(data, CanAddress(arb))

    def until(self, pgn, source):
        """The fields of this device's next message of this PGN."""
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            frame = self.bus.recvmsg()
            line = f"({frame.t_ns / 1e9:.6f}) can1 {frame.identifier:08X}#{frame.data.hex().upper()}"
            message = self._decoder.decode(line)
            if message is not None and (message.PGN, message.source) == (pgn, source):
                return {field.id: field.value for field in message.fields}
        raise AssertionError(f"no {pgn} of {source} in {PATIENCE_S:.0f} s")


@pytest.mark.long
def test_a_display_sees_the_boat_by_its_name_and_the_boat_obeys_nobody_there(tmp_path):
    name = f"canloop:n2k-{os.getpid()}-{tmp_path.name[-8:]}"
    more = (f'nmea2000.interface="{name}"', 'nmea2000.send=["position","heading","alerts"]')
    with open_can(name) as bus, running(tmp_path, 14550, "mavlink.enabled=false", *more) as command:
        display = Display(bus)
        position = display.until(129025, FIRST)
        with Link(command, PATIENCE_S) as link:
            state = link.ask("state")
        assert position["latitude"] == pytest.approx(state["latitude_deg"], abs=1e-4)
        assert position["longitude"] == pytest.approx(state["longitude_deg"], abs=1e-4)
        display.say(Parcel(REQUEST, PRODUCT.to_bytes(3, "little"), DISPLAY, 6, FIRST))
        product = display.until(PRODUCT, FIRST)
        assert (product["modelId"], product["modelVersion"]) == ("Delfim", "DelfimX")

        display.say(Parcel(126208, b"\x01" + (127237).to_bytes(3, "little") + b"\xf8\x01\x0b\x00\x00", DISPLAY, 3, FIRST))
        assert display.until(126208, FIRST)["functionCode"] == "Acknowledge"
        display.say(Parcel(CLAIM, (1).to_bytes(8, "little"), FIRST))
        display.until(CLAIM, FIRST + 1)
        display.until(127250, FIRST + 1)
        with Link(command, PATIENCE_S) as link:
            assert link.ask("state")["mode"] == "idle"

"""Two boats as devices of one bus of the kernel's, which goes down and comes back: python -m tests.parts.nmea2000.nmea2000_pair
INTERFACE

Prints one JSON object: the addresses before and after, what they said of the bus meanwhile, and how many claims were on it.
"""

import json
import select
import subprocess
import sys
import time
from collections.abc import Callable
from random import Random

from delfim import config
from delfim.base.clock import SystemClock
from delfim.canproxy.nmea2000.device import FIRST, Device
from delfim.canproxy.nmea2000.parcels import CLAIM, addressed
from delfim.canproxy.opening import open_bound, open_can
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.parts.nmea2000.nmea2000d import BoatDevice
from delfim.parts.nmea2000.table import Nmea2000
from delfim.vehicle.report import BoatReport

PATIENCE_S = 200.0


class Pair:
    def __init__(self, interface: str) -> None:
        self._interface, self.cycle, self.claims = interface, 0, 0
        self._observer = open_can(interface)
        self._observer.bind(ANYTHING)
        self.boats = [self._boat(name) for name in ("one", "two")]

    def _boat(self, name: str) -> tuple[CanSocket, BoatDevice]:
        filters = tuple(CanAddress(arb, mask) for arb, mask in Device.FILTERS)
        bus = open_bound(config.Can(), self._interface, filters)
        table = Nmea2000(interface=self._interface, send=("heading",))
        settings = config.Vehicle(boat=config.BoatTable(name=name), nmea2000=table)
        return bus, BoatDevice(bus, settings, SystemClock(), FIRST, Random(name))

    def until(self, wanted: Callable[[], bool]) -> None:
        """Both live, their vehicles publish, and lost interfaces are taken up again."""
        deadline_s = time.monotonic() + PATIENCE_S
        while not wanted():
            if time.monotonic() > deadline_s:
                raise SystemExit(f"not in {PATIENCE_S:.0f} s: {[boat.report() for _, boat in self.boats]}")
            select.select([], [], [], 0.02)
            self.cycle += 1
            state = BoatReport(mode="idle", reason="", cycle=self.cycle, heading_deg=90.0, age_s={"navigation": 0.0})
            for bus, boat in self.boats:
                boat.on_frames()
                if self.cycle % 10 == 0:
                    boat.heard(state)
                if self.cycle % 50 == 0:
                    bus.rebind()
            self._observe()

    def _observe(self) -> None:
        try:
            while (frame := self._observer.receive()) is not None:
                self.claims += addressed(frame.arb)[0] == CLAIM
        except OSError:
            self._observer.rebind()

    def addresses(self) -> list[int]:
        return [boat.device.address for _, boat in self.boats if boat.device.is_claimed]

    def sent(self) -> list[int]:
        return [boat.parcels.sent[127250] for _, boat in self.boats]

    def troubles(self) -> list[str]:
        return [str(boat.parcels.trouble) for _, boat in self.boats]


def main(interface: str) -> None:
    pair = Pair(interface)
    pair.until(lambda: len(pair.addresses()) == 2 and min(pair.sent()) > 5)
    told = {"before": pair.addresses(), "claims_before": pair.claims}
    subprocess.run(["ip", "link", "set", interface, "down"], check=True)
    down_s = time.monotonic()
    pair.until(lambda: all(pair.troubles()) and time.monotonic() - down_s > 4.0)
    told["troubles"] = pair.troubles()
    subprocess.run(["ip", "link", "set", interface, "up"], check=True)
    sent = pair.sent()
    pair.until(lambda: pair.claims >= told["claims_before"] + 2 and len(pair.addresses()) == 2)
    pair.until(lambda: all(now > before + 5 for now, before in zip(pair.sent(), sent, strict=True)))
    told |= {"after": pair.addresses(), "claims_after": pair.claims, "troubles_after": pair.troubles()}
    print("REPORT", json.dumps(told))


if __name__ == "__main__":
    main(sys.argv[1])

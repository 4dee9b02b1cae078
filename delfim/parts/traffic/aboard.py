"""Other vessels aboard: the look-out and the watchkeeper share the watchdog's time, and a bus with AIS is read."""

from delfim.parts.traffic.aisbus import open_ais_bus
from delfim.parts.traffic.lookout import TrafficLookout
from delfim.parts.traffic.watchkeeper import Watchkeeper
from delfim.vehicle.aboard import Added, OpenedWith
from delfim.vehicle.helm.helm import Helm


class VesselWatch:
    def __init__(self, boat: OpenedWith) -> None:
        self._state, self._lookout = boat.state, TrafficLookout(boat.settings.traffic)
        self._keeper = Watchkeeper(boat.settings, boat.clock, boat.state, boat.log)

    def look(self, helm: Helm, now_s: float) -> None:
        self._lookout.hear(self._state)
        if not self._keeper.look(helm, now_s):
            self._lookout.look(self._state, now_s)

    def report(self, now_s: float) -> dict[str, object]:
        return {"traffic": self._keeper.told(now_s)}


def opened(boat: OpenedWith) -> Added:
    """Open the look-out and the watchkeeper. Raises DelfimError."""
    bus = open_ais_bus(boat.settings, boat.links)
    return Added(VesselWatch(boat), () if bus is None else (bus,))

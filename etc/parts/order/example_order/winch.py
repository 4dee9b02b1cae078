"""The winch: a frame tells how much rope is out, another one how much shall be. Both have floats of four bytes."""

import math
import struct

from delfim.api import BusError, CanAddress, CanSocket, Links, OrderAsked, Pause, State, Value, Vehicle, standard
from example_order import WinchTable

VALUES = (Value("rope_m", "m", "rope that is out", "rope"),)
WANTED, OUT = CanAddress(standard(0x160)), CanAddress(standard(0x161))
FRAMES_MAX = 64  # in one read


class Winch:
    name = "example_order"

    def __init__(self, bus: CanSocket) -> None:
        self.input = bus

    def read(self, state: State, now_s: float) -> None:
        """All that has come, into the state. Never raises, never waits."""
        try:
            for _ in range(FRAMES_MAX):
                if (frame := self.input.receive()) is None:
                    return
                rope_m = struct.unpack("<f", frame.data)[0] if len(frame.data) == 4 else math.nan
                if 0.0 <= rope_m <= 100.0:
                    state.measured["rope_m"] = rope_m, now_s
                else:
                    state.count("example_order_malformed")
        except BusError:
            state.count("example_order_bus_errors")

    def tell(self, rope_m: float, rate_mps: float) -> bool:
        """Whether the bus takes it."""
        try:
            self.input.sendto(struct.pack("<ff", rope_m, rate_mps), WANTED)
        except OSError:
            return False
        return True


def open_sensor(settings: Vehicle, links: Links) -> Winch:
    return Winch(links.bus(settings.of(WinchTable).interface, (OUT,)))


def pay_out(asked: OrderAsked) -> str | None:
    """Carried out: None. Refused: the reason, in words. It waits for nothing: what the winch does is told by its values."""
    if asked.sensor is None:
        return "the winch is not among sensors.names"
    fastest_mps, motion = asked.settings.of(WinchTable).pays_out_below_mps, asked.state.motion
    if "velocity" in motion.has and math.hypot(motion.north_mps, motion.east_mps) > fastest_mps:
        return f"the boat is faster than {fastest_mps:g} m/s"
    return None if asked.sensor.tell(asked.values.rope_m, asked.values.rate_mps) else "the bus takes nothing"


def station(asked: OrderAsked) -> str | Pause:
    """An order may end in one of the boat's own, which is admitted or refused as the operator's."""
    if asked.sensor is None or not asked.sensor.tell(0.0, 1.0):
        return "the winch does not take it"
    return Pause()

"""An echo sounder that speaks the Ping protocol: each ping once, with its confidence; and the depth of those that are sure."""

from typing import Final

from delfim import config
from delfim.base.errors import FormatError
from delfim.lines.binaryframes import BinaryFrames
from delfim.parts.ping.pingframes import FRAMING, asked, distance, unpacked
from delfim.parts.ping.table import PingTable
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.sensors import Value
from delfim.vehicle.state import Ping, State

NAME: Final = "ping"
VALUES = (Value("depth_m", "m", "below the transducer"),)
SILENT_S: Final = 3.0  # it is asked again, as often


class PingSounder:
    """Asks to be told of each ping, and again where nothing comes: the sounder may have been off."""

    name = NAME

    def __init__(self, table: PingTable, line: ReadableLine, confidence: float) -> None:
        self.input, self._frames, self._confidence = line, BinaryFrames(FRAMING), confidence
        self._asks = asked(table.rate_hz, table.sound_mps)
        self._spoke_s: float | None = None  # when it was heard, or asked

    def read(self, state: State, now_s: float) -> None:
        """Take the pings that came. Frames that cannot be read are counted."""
        before = self._frames.refused
        while data := self.input.read():
            for frame in self._frames.feed(data):
                try:
                    found = distance(unpacked(frame))
                except FormatError:
                    state.count("ping_malformed")
                    continue
                if found is not None:
                    self._spoke_s = now_s
                    ping = Ping(now_s, found.range_m, NAME, None, found.confidence, found.number)
                    state.sound(ping, found.confidence >= self._confidence and found.range_m > 0.0)
            if self.input.fileno() >= 0:
                break
        if self._frames.refused > before:
            state.count("ping_refused", self._frames.refused - before)

    def look(self, helm: Helm, now_s: float) -> None:
        """Ten times a second: ask a sounder that is silent."""
        if self._spoke_s is None or now_s - self._spoke_s >= SILENT_S:
            self._spoke_s = now_s
            self.input.write(self._asks)

    def report(self, now_s: float) -> dict[str, object]:
        return {}


def open_sensor(settings: config.Vehicle, links: Links) -> PingSounder:
    """Raises DelfimError."""
    table = settings.of(PingTable)
    return PingSounder(table, links.line(table.device, table.baud), settings.sounder.confidence)

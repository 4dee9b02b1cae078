"""The kinds of oracles that are lines of text."""

from collections.abc import Callable
from typing import Final, NamedTuple

from tests.oracles import statelogs, telling, vehiclefiles, wires
from tests.oracles.comparing import Explain, plain
from tests.oracles.keeping import Lines


class Kind(NamedTuple):
    """`measured`: a line with this word in it has values of the simulation, whose last digits are those of this machine."""

    make: Callable[[], Lines]
    explain: Explain = plain
    measured: str = ""


LINES: Final = {
    "vehicle-files": Kind(vehiclefiles.files, vehiclefiles.explained),
    "state-logs": Kind(statelogs.state_logs, statelogs.explained, "record "),
    "drivers": Kind(wires.drivers),
    "wires": Kind(wires.boats, measured=", device: "),
    "telemetry": Kind(telling.telemetry),
    "web": Kind(telling.web),
    "instruments": Kind(telling.instruments),
}

"""The other nodes' traffic, recorded for a guest in which no processor is left for them."""

from pathlib import Path

from delfim import config
from delfim.base.frames import Frame
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import BatteriesCommand, PropellerCommand
from delfim.logging.candump import format_line
from delfim.simulator.nodes import nodes_of


def record(vehicle: Path, file: Path, seconds: float) -> Path:
    """What the nodes of a boat at rest, which hear its commands, say in so long: a file as candump writes them."""
    settings = config.load(vehicle)
    nodes, lines = nodes_of(settings, 1), []
    for cycle in range(round(seconds * settings.navigation.rate_hz)):
        now_s = cycle / settings.navigation.rate_hz
        at_ns = round(1_700_000_000e9 + now_s * 1e9)
        for frame in commands(cycle):
            nodes.feed(frame, now_s)
        lines += [format_line(frame._replace(t_ns=at_ns), "vcan0") for frame in nodes.step(now_s, at_ns)]
    file.write_text("".join(f"{line.strip()}\n" for line in lines))
    return file


def commands(counter: int) -> list[Frame]:
    """Of a boat in idle: motors off, batteries connected."""
    off = messages.pack_propeller_command(PropellerCommand(0, False, counter & 0xFF))
    on = messages.pack_batteries_command(BatteriesCommand(True, counter))
    return [Frame(arb, off) for arb in (messages.PROPELLER_STARBOARD, messages.PROPELLER_PORT)] + [
        Frame(arb, on) for arb in (messages.BATTERIES_STARBOARD, messages.BATTERIES_PORT)
    ]

"""The operators aboard: a hand-set, a kill switch, or both."""

from delfim.parts.handset.killswitch import KillSwitch
from delfim.parts.handset.operator import open_handset
from delfim.vehicle.aboard import Added, Hand, OpenedWith


def opened(boat: OpenedWith) -> Added:
    """Open the operators aboard. Raises DelfimError."""
    hands, settings, links = list[Hand](), boat.settings, boat.links
    if settings.handset.device:
        hands.append(open_handset(settings.handset, links))
    if settings.kill.chip and links.gpio:
        kill = settings.kill
        hands.append(KillSwitch(kill, links.gpio(kill.chip, kill.line, kill.bias)))
    return Added(hands=tuple(hands))

"""Who commands: one page, or nobody. A pure state machine; the gateway obeys orders of the holder alone.

A page is told that it was given the command, and has it once it says that it knows. It keeps it while it proves that it hears
the gateway: a page answers each word with its number, and one that has proven nothing for LEASE_S has lost the command. A page
itself takes what it heard for true for longer than that, so that nobody commands who does not know it.
"""

from typing import Final, NamedTuple

from delfim.base.errors import Refused

TOLD_S: Final = 0.5  # between two words of the gateway about who commands
LEASE_S: Final = 2.0  # the page takes the gateway for lost after 3 s (SILENT_MS of net.ts)
CARRY_S: Final = 1.0  # a link with older proof than this cannot carry a stop


class Bridge(NamedTuple):
    """Pages by their numbers; 0: none."""

    holder: int = 0
    granted: int = 0  # it was given the command, and has not said yet that it knows
    grant: int = 0  # counts them
    offered: int = 0  # the holder offers it the command

    @property
    def is_free(self) -> bool:
        return not (self.holder or self.granted)


def take(bridge: Bridge, page: int, proof_s: float) -> Bridge:
    """Nobody commands, and this page wants to. `proof_s`: how old the last proof is that it hears. Raises Refused."""
    if not bridge.is_free:
        raise Refused("somebody commands: the command is offered, and accepted")
    return _granted(bridge, page, proof_s)


def offer(bridge: Bridge, page: int, to: int) -> Bridge:
    """Offers the command, or withdraws the offer (0). Raises Refused."""
    if not page or page != bridge.holder:
        raise Refused("who does not command has nothing to offer")
    return bridge._replace(offered=to if to != page else 0)


def accept(bridge: Bridge, page: int, proof_s: float) -> Bridge:
    """Raises Refused."""
    if not page or page != bridge.offered:
        raise Refused("the command was not offered to this page")
    return _granted(bridge, page, proof_s)


def know(bridge: Bridge, page: int, grant: int) -> Bridge:
    """A page says that it knows of this grant."""
    known = bool(page) and page == bridge.granted and grant == bridge.grant
    return bridge._replace(holder=page, granted=0) if known else bridge


def leave(bridge: Bridge, page: int) -> Bridge:
    """A page is gone, is deaf, may command no longer, or wants to no longer."""
    kept = {name: 0 for name in ("holder", "granted", "offered") if getattr(bridge, name) == page}
    if "holder" in kept:
        kept["offered"] = 0
    return bridge._replace(**kept)


def _granted(bridge: Bridge, page: int, proof_s: float) -> Bridge:
    if proof_s > CARRY_S:
        raise Refused(f"the link of this page cannot carry a stop: it was heard to hear {proof_s:.1f} s ago")
    return Bridge(granted=page, grant=bridge.grant + 1)

"""The health of the boat's own nodes, as they report it: whether the boat may sail with it."""

from collections.abc import Container

from delfim import config
from delfim.canproxy.dsor.messages import Fault, Node, Status
from delfim.vehicle.state import State
from delfim.vehicle.target import NEVER_S

PROPELLERS = (Node.PROPELLER_STARBOARD, Node.PROPELLER_PORT)  # by address of the driver dsor
NAMES: dict[int, str] = {
    Node.GPS: "gps",
    Node.PROPELLER_STARBOARD: "propeller_starboard",
    Node.PROPELLER_PORT: "propeller_port",
    Node.BATTERIES_STARBOARD: "batteries_starboard",
    Node.BATTERIES_PORT: "batteries_port",
}


def wrong(
    state: State, required: config.Sysstat, now_s: float, but: Container[str] = (), since_s: float = NEVER_S
) -> str | None:
    """The first reason why the boat may not sail, in words: a required node that is silent or bad, and not among `but`. From
    `since_s` on each has its time to report, and a propeller to report that it hears commands."""
    reports, stale_s, bad = state.sysstat, required.stale_s, Status.BAD
    is_new = now_s - since_s <= stale_s
    for name in required.required or ():
        if name in but:
            continue
        report = reports.get(name)
        if report is None:
            if is_new:
                continue
            return f"{name.replace('_', ' ')} has not reported"
        status, at_s = report
        if now_s - at_s > stale_s:
            return f"{name.replace('_', ' ')} silent for {now_s - at_s:.1f} s"
        if status.status == bad and not (is_new and status.faults == Fault.NO_COMMAND):
            return f"{name.replace('_', ' ')} bad: {words(status.faults)}"
    return None


def named(faults: Fault) -> list[str]:
    return [fault.name.lower().replace("_", " ") for fault in Fault if fault in faults and fault.name]


def words(faults: Fault) -> str:
    return ", ".join(named(faults)) or "no reason given"

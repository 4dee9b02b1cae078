"""Rules of orders and modes: who changes the mode, and what an order leads to."""

from collections.abc import Iterator
from typing import Final

from delfim.audit.evidence import IDLE, LEADS, LOOK_S, SAME_S, Evidence, LoggedOrder, ModeChange, spells
from delfim.audit.rule import Finding, Rule

NAMED: Final = ("manual", "heading", "course", "goto", "play", "path")  # orders that are called as their modes
BY_OPERATOR: Final = "operator"
BY_PAYLOAD: Final = "payload"  # begins the reason of a change of mode that a program ordered, and its operator's name
SENSOR: Final = "sensor "  # begins the name of a sensor that the boat hears itself, which sees, and orders nothing
RIGHTS: Final = {  # of payload programs, by their orders
    "pause": "hold",
    "sight": "obstacles",
    "sampled": "samples",
    "tell": "values",
    **{word: word for word in ("goto", "speed", "heading")},
    "course": "heading",
    **dict.fromkeys(("upload", "play", "continue"), "mission"),
}
ENDS: Final = {  # of modes that are done
    "goto": ("hold", IDLE),
    **dict.fromkeys(("play", "path", "home"), ("hold",)),
    "unstick": ("hold", "home", IDLE),
}
SHORTEST: Final = 8  # letters of a reason
STICK_S: Final = 1.05  # a stick that was let go says nothing for a second
PROGRAM: Final = ("shutdown", "end of the run", "started", "stopped")  # the program's own ends and begins


def mode_causes(e: Evidence) -> Iterator[Finding]:
    for each in e.modes:
        if complaint := _uncaused(e, each):
            yield Finding(each.t_s, f"from {each.before} to {each.mode} ({each.reason}): {complaint}")


def _uncaused(e: Evidence, change: ModeChange) -> str:
    """The reason why nothing in the log explains a change of mode; empty where something does."""
    reason, mode = change.reason, change.mode
    if not reason:
        return "without a reason"
    if reason.startswith((BY_OPERATOR, f"{BY_PAYLOAD} ")):
        return _unordered(e, change)
    if reason.partition(":")[0] == f"{change.before} done":
        return "" if mode in ENDS.get(change.before, ()) else f"{change.before} does not end in {mode}"
    if reason.startswith("restarted: "):
        return (
            ""
            if any(abs(each.begin_s - change.t_s) < LOOK_S for each in e.named("restarted")) or change.before == IDLE
            else "?"
        )
    if mode == IDLE and reason.startswith(PROGRAM):
        return ""
    if mode == change.before:
        return ""  # it waits, and says for what
    return _untroubled(e, change)


def _untroubled(e: Evidence, change: ModeChange) -> str:
    """The reason why no trouble explains it. A trouble that is present is noted again only where its action changes."""
    said = ""
    for alarm in e.alarms:
        told = [each for each in alarm.told if each.t_s <= change.t_s + SAME_S]
        if not told or alarm.end_s < change.t_s - SAME_S:
            continue
        near = [each for each in told if each.t_s >= change.t_s - SAME_S] or told[-1:]
        if any(_leads(each.action, change.mode) for each in near):
            return ""
        said = f"{alarm.name} says {near[-1].action}" if near[-1].words in change.reason else said
    return said or "nobody ordered it, and no trouble with such an action is present"


def _leads(action: str, mode: str) -> bool:
    return mode in LEADS.get(action, ())


def _unordered(e: Evidence, change: ModeChange) -> str:
    if change.mode in ("manual", IDLE) and _has_handset(e):
        return ""  # take-over and giving back are no orders of the sidecar
    if change.mode == "goto" and change.before == "goto":
        return ""  # the way round that it waited for
    whose = [each for each in e.obeyed(change.t_s, LOOK_S) if change.reason.startswith(BY_PAYLOAD) is bool(_program(each))]
    return "" if any(_asks(each, change.mode) for each in whose) else "no order of this time asked for it"


def _program(order: LoggedOrder) -> str:
    """The payload program that gave an order; empty: an operator did."""
    return order.operator.removeprefix(f"{BY_PAYLOAD}:") if order.operator.startswith(f"{BY_PAYLOAD}:") else ""


def _has_handset(e: Evidence) -> bool:
    return bool(e.setting("handset.device"))


def _asks(order: LoggedOrder, mode: str) -> bool:
    """Whether an order may lead to this mode."""
    if order.name == "mode":
        return str(order.value.get("mode")) == mode or mode in ("hold", IDLE)
    if order.name in NAMED:
        return order.name == mode
    if order.name in ("stop", "clear", "kill", "shutdown"):
        return mode == IDLE
    return True  # continue, pause and what else there is: their modes depend on the past


def idle_left(e: Evidence) -> Iterator[Finding]:
    for each in e.modes:
        if each.before == IDLE and each.mode != IDLE and not each.reason.startswith((BY_OPERATOR, "restarted: ")):
            yield Finding(each.t_s, f"the boat left idle for {each.mode} by itself ({each.reason})")


def refused_changes_nothing(e: Evidence) -> Iterator[Finding]:
    for order in e.orders:
        if not order.refused:
            continue
        if len(order.refused.strip()) < SHORTEST:
            yield Finding(order.t_s, f"{order.name} was refused without a reason")
        for each in e.changes(order.t_s, SAME_S):
            if (
                each.reason.startswith((BY_OPERATOR, f"{BY_PAYLOAD} "))
                and not e.obeyed(order.t_s, LOOK_S)
                and not _has_handset(e)
            ):
                yield Finding(order.t_s, f"{order.name} was refused ({order.refused}), and the boat went to {each.mode}")


def orders_obeyed(e: Evidence) -> Iterator[Finding]:
    pushed_s = -STICK_S  # the last order of a stick: one that stays pushed after a failsafe is ignored
    for order in e.orders:
        if order.refused:
            continue
        asked = str(order.value.get("mode")) if order.name == "mode" else order.name if order.name in NAMED else ""
        asked = IDLE if order.name == "stop" else asked
        near = {each.mode for each in e.changes(order.t_s, LOOK_S)} | {e.mode_at(order.t_s + SAME_S)}
        is_stick = order.name == "manual" and order.t_s - pushed_s < STICK_S
        if asked and asked not in near and not is_stick:
            yield Finding(order.t_s, f"{order.name} was obeyed, and the boat is in {', '.join(sorted(near))}")
        pushed_s = order.t_s if order.name == "manual" else pushed_s


def programs_below(e: Evidence) -> Iterator[Finding]:
    """The boat is a program's from an operator's order that gives it until the next order of any operator."""
    given = ""
    for order in e.orders:
        program = _program(order)
        if not program:
            given = str(order.value.get("name")) if order.name == BY_PAYLOAD and not order.refused else ""
        elif not (order.refused or (order.name == "sight" and program.startswith(SENSOR))):
            right = RIGHTS.get(order.name, "")
            if right not in e.setting(f"payload.{program}.may"):
                yield Finding(order.t_s, f"{order.name} of payload {program} was obeyed, which has no right to it")
            elif program != given and right not in ("obstacles", "samples", "values"):
                yield Finding(order.t_s, f"{order.name} of payload {program} was obeyed, and no operator had given it the boat")


def modes_agree(e: Evidence) -> Iterator[Finding]:
    said = [e.mode_at(float(t_s)) for t_s in e.t_s]
    for first, _ in spells(e.record_modes != said):
        t_s = float(e.t_s[first])
        if e.record_modes[first] not in e.modes_about(t_s):
            yield Finding(t_s, f"the records say {e.record_modes[first]}, the sidecar {said[first]}")


RULES: Final = (
    Rule(
        "mode-causes",
        "Each change of mode has its cause: an order, a trouble with such an action, or the end of a mode.",
        "failsafe.md#the-table",
        mode_causes,
    ),
    Rule("idle-left", "Nobody leaves idle by himself, but after a restart.", "failsafe.md#the-table", idle_left),
    Rule(
        "refused-changes-nothing",
        "An order that is refused has a reason, and changes nothing.",
        "failsafe.md#checks-before-the-start",
        refused_changes_nothing,
    ),
    Rule("orders-obeyed", "An order that is not refused leads to its mode.", "control.md", orders_obeyed),
    Rule(
        "programs-below",
        "A payload program's order is obeyed where its table has the right, and while an operator gives it the boat.",
        "payloads.md#who-has-the-boat",
        programs_below,
    ),
    Rule("modes-agree", "Records and sidecar tell the same mode.", "log-format.md#the-state-log-state", modes_agree),
)

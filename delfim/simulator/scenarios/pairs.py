"""Pairs of what happens to a boat at once: the mode that it is in, the troubles that it has, the action of its failsafe, the
order of its operator. The number of possible ones that a campaign has met shows how much of the boat it has tried.

docs/campaigns.md says what counts. A thing is a word and a name, as in "trouble log" or "order goto refused".
"""

from collections.abc import Iterable
from itertools import combinations
from typing import Final, NamedTuple

from delfim.base.modes import Mode
from delfim.base.parts import TROUBLES as OF_LABORATORIES
from delfim.simulator.lockstep import Lockstep, Ordered
from delfim.vehicle import console
from delfim.vehicle.failsafe.failsafe import Action
from delfim.vehicle.failsafe.troubles import NUMBERS
from delfim.vehicle.loop import HELD_BY_HAND

REFUSED: Final = " refused"
NO_ORDERS: Final = (  # words of a console, and of the program, that ask nothing of the boat; of payloads and parts, which
    # campaigns lack
    *("alive", "state", "watch", "return", "payload", "sight", "sampled", "tell", "order", "ordered", "trial", "overrule"),
)
OBEYED_ALWAYS: Final = ("stop", "kill", "leave", "speed", "rally", "take", "shutdown")  # by the helm, whatever happens

MODES: Final[dict[Mode, str]] = {  # campaigns try no motors, and go astern only where a file says so
    mode: f"mode {mode.name.lower()}" for mode in Mode if mode not in (Mode.TRIAL, Mode.UNSTICK)
}
TROUBLES: Final = {number: f"trouble {name}" for name, number in NUMBERS.items() if number not in OF_LABORATORIES}
ACTIONS: Final = tuple(f"action {action.name.lower()}" for action in Action if action not in (Action.NONE, Action.UNSTICK))
OBEYED: Final = tuple(f"order {name}" for name in console.KINDS if name not in NO_ORDERS)
ORDERS: Final = (*OBEYED, *(f"{each}{REFUSED}" for each in OBEYED if each.removeprefix("order ") not in OBEYED_ALWAYS))
THINGS: Final = (*MODES.values(), *TROUBLES.values(), *ACTIONS, *ORDERS)
NUMBER: Final = {thing: number for number, thing in enumerate(THINGS)}


class Never(NamedTuple):
    """Two kinds of things that never meet, with the reason."""

    these: frozenset[str]
    those: frozenset[str]
    why: str


def kind_of(thing: str) -> str:
    return thing.partition(" ")[0]


def _troubles(names: str) -> frozenset[str]:
    return frozenset(f"trouble {name}" for name in names.split())


def _orders(names: str) -> frozenset[str]:
    return frozenset(f"order {name.replace('-', ' ')}" for name in names.split())


def _all_but(things: Iterable[str], *names: str) -> frozenset[str]:
    return frozenset(things) - {*names}


_SAILING: Final = _all_but(MODES.values(), "mode idle")
_KILL: Final = _troubles("kill")
_UNDER_WAY: Final = _troubles("control navigation_frozen manual_silent console_silent guest_silent fence_left stuck")
_MOVING: Final = frozenset({"action hold", "action back", "action home"})
_STOPPED: Final = frozenset({"action stop", "action disconnect"}) | _KILL | _troubles("control")
_BEGIN: Final = _orders("manual heading course goto continue play")  # orders that enter a mode
IMPOSSIBLE: Final = (
    Never(frozenset({"mode idle"}), _UNDER_WAY, "these are looked at under way alone"),
    Never(frozenset({"mode home"}), frozenset({"action home"}), "it is on its way already"),
    Never(_troubles("manual_silent"), _all_but(MODES.values(), "mode manual"), "nobody steers by hand in another mode"),
    Never(_troubles("guest_silent"), _all_but(MODES.values(), "mode grex"), "nobody asks the guest in another mode"),
    Never(_troubles("manual_silent"), _troubles("guest_silent"), "each is of a mode of its own"),
    Never(_KILL, _SAILING | _UNDER_WAY, "a kill is a stop, and no mode is entered before it is cleared"),
    Never(_KILL, _MOVING | {"action warn"}, "its action is a stop, and a graver one alone is taken in its place"),
    Never(_troubles("control"), _MOVING | {"action warn"}, "its action is a stop, and nothing graver is done under way"),
    Never(frozenset({"mode idle"}), _MOVING, "a boat in idle stays there"),
    Never(frozenset({"action disconnect"}), _SAILING | _UNDER_WAY, "what turns is disconnected where all was switched off"),
    Never(_KILL, _BEGIN | _orders("arm actuate"), "until a kill is cleared the boat is idle, and nothing turns"),
    Never(
        _orders("clear"),
        _SAILING | _UNDER_WAY | _MOVING | {"action warn"},
        "only a killed boat obeys it, and that stays in idle",
    ),
    Never(_orders("pause"), frozenset({"mode idle"}), "there is nothing to pause"),
    Never(_orders("pause-refused"), _SAILING, "it is refused in idle alone"),
    Never(_orders("continue"), _all_but(MODES.values(), "mode hold"), "only a hold remembers what it interrupted"),
    Never(_orders("reset actuate arm-refused"), _SAILING, "they are for a boat in idle"),
    Never(_troubles("control"), frozenset({"mode manual"}) | _troubles("manual_silent"), "by hand nothing measured is needed"),
    Never(
        _troubles("restarted"),
        frozenset({"mode manual"}) | _troubles("manual_silent kill") | _orders("clear"),
        "thrust by hand is not gone on with, a killed boat was in idle, and any order ends it",
    ),
    Never(
        _STOPPED,
        _orders("pause continue unload-refused"),
        "the boat is in idle by then, and these are for one that sails",
    ),
    Never(
        _troubles("manual_silent guest_silent"),
        _orders("continue unload-refused"),
        "neither by hand nor for a guest is a mission sailed, and only a guest who is heard is followed again",
    ),
    Never(
        _troubles("control"),
        _orders("goto play"),
        "its mode lacks position, heading or velocity, and these need all three",
    ),
    Never(
        _troubles("control"),
        _troubles("navigation_twice"),
        "who speaks twice is the navigation node, which tells the heading with all else or tells nothing",
    ),
    Never(
        _troubles("fence_left"),
        _orders("heading course goto play continue"),
        "a boat outside its fence is driven by hand alone",
    ),
    Never(
        _troubles("stuck"),
        frozenset({"mode manual", "mode hold"}),
        "by hand and in hold nobody looks whether the boat goes",
    ),
    Never(_MOVING, _orders("unload-refused"), "a boat that holds or goes home sails no mission any more"),
    Never(_orders("unload"), frozenset({"mode play", "mode path"}), "what is sailed is kept"),
    Never(_orders("unload-refused"), _all_but(MODES.values(), "mode play", "mode path"), "no mission is being sailed"),
)


def possible(one: str, other: str) -> bool:
    return not any(
        (one in never.these and other in never.those) or (other in never.these and one in never.those) for never in IMPOSSIBLE
    )


def _is_pair(one: str, other: str) -> bool:
    return kind_of(one) != kind_of(other) or kind_of(one) == "trouble"


ALL: Final = tuple(pair for pair in combinations(THINGS, 2) if _is_pair(*pair))
PAIRS: Final = tuple(pair for pair in ALL if possible(*pair))
PLACE: Final = {(NUMBER[one], NUMBER[other]): place for place, (one, other) in enumerate(ALL)}


class PairTape:
    """The pairs that a run meets, by their places in ALL. Call `look` after each cycle."""

    def __init__(self) -> None:
        self.met = set[int]()
        self._seen = set[tuple[int, ...]]()  # what was there at once
        self._ordered: Ordered | None = None
        self._looked_s = 0.0

    def look(self, run: Lockstep) -> None:
        helm, state, was_s = run.vehicle.helm, run.state, self._looked_s
        now_s = self._looked_s = state.watchdog_s
        if not helm.troubles and run.ordered is self._ordered:
            return
        on, action, there = list[str](), tuple[str, ...](), state.notices
        if now_s != was_s:  # ten cycles a second may be one more than the failsafe looks
            found = [(trigger, each) for trigger, each in helm.troubles.items() if trigger in TROUBLES]
            on = [TROUBLES[trigger] for trigger, each in found if each.seen_s == now_s and each.acting_s <= now_s]
            action = (f"action {there[0].action}",) if there else ()
        self._meet((MODES.get(run.vehicle.judged_in, ""), *on, *action))
        if run.ordered is not self._ordered and (order := run.ordered) is not None:
            self._ordered = order
            name = f"order {order.name}{REFUSED if order.refused else ''}"
            if name in NUMBER and HELD_BY_HAND not in order.refused:
                self._meet((MODES.get(order.mode, ""), name))
                self._meet((*on, *action, name))

    def _meet(self, things: tuple[str, ...]) -> None:
        numbers = tuple(sorted([NUMBER[each] for each in things if each in NUMBER]))
        if numbers in self._seen:
            return
        self._seen.add(numbers)
        self.met.update(PLACE[pair] for pair in combinations(numbers, 2) if pair in PLACE)

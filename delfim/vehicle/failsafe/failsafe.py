"""Troubles and the action that the boat takes for each: one table, trouble by trouble and mode by mode (thesis 2.12, 3.4).

The table is `[failsafe]` of the vehicle's file, `docs/failsafe.md` explains it; `troubles.py` detects them. Nothing here
moves anything: ten times a second `failsafe` derives the action from the state, and the loop does it.
When a trouble ends, the boat does not resume what it was doing: the operator acts.
"""

import math
from collections.abc import Mapping
from enum import IntEnum
from operator import itemgetter
from types import MappingProxyType
from typing import Final, NamedTuple

from delfim import config
from delfim.base.modes import Mode
from delfim.vehicle.control.control import admit
from delfim.vehicle.failsafe.troubles import NUMBERS, Inputs, Look, PartTrigger, Trigger, troubles
from delfim.vehicle.state import Notice, Setpoint, State


class Action(IntEnum):
    """By severity."""

    NONE = 0
    WARN = 1
    HOLD = 2
    BACK = 3  # hold some way back along the driven track
    UNSTICK = 4  # astern, out by the way it came
    HOME = 5
    STOP = 6
    DISCONNECT = 7  # the batteries of a propeller that turns although it was stopped


class Episode(NamedTuple):
    """A trouble, from when it is first detected until it has been absent for `clear_s`."""

    reason: str
    since_s: float
    seen_s: float  # last time it was detected
    acting_s: float  # when it had lasted for `after_s`; infinite before
    answered: bool  # the boat went home for it, or the operator overruled that


AnyTrigger = Trigger | PartTrigger
Memory = Mapping[AnyTrigger, Episode]
_new = tuple.__new__  # a third of the time of Episode(...): each trouble has one, ten times a second


class Verdict(NamedTuple):
    memory: Memory
    action: Action
    reason: str  # of the action
    notices: tuple[Notice, ...]


_DOES: Final = {
    Action.HOME: (Mode.HOME, Mode.HOLD),
    Action.UNSTICK: (Mode.UNSTICK, Mode.HOLD),
    Action.HOLD: (Mode.HOLD,),
    Action.BACK: (Mode.HOLD,),
    Action.STOP: (),
}
NO_TROUBLE: Final[Memory] = MappingProxyType({})
_WELL: Final = Verdict(NO_TROUBLE, Action.NONE, "", ())
_NEVER_S: Final = math.inf
_DONE: Final = {action: action.name.lower() for action in Action}


class Rules:
    """The table of a vehicle's file, looked up by trigger and mode. `of_parts`: the troubles of those aboard."""

    def __init__(self, settings: config.Vehicle, of_parts: tuple[PartTrigger, ...] = ()) -> None:
        self.settings, self.table, self.pause_s = settings, settings.failsafe, settings.failsafe.pause_s
        self.clear_s = settings.failsafe.clear_s
        self.of_parts = of_parts
        every: tuple[AnyTrigger, ...] = (*Trigger, *self.of_parts)
        self.names = {trigger: trigger.name.lower() for trigger in every}  # as the vehicle's file has them
        self.lasting_s = {trigger: _lasting_s(self.table, trigger) for trigger in every}
        actions = {trigger: {mode: _action(self.table, trigger, mode) for mode in Mode} for trigger in every}
        if not settings.adopted.proven:
            actions = {trigger: {mode: unsteered(each) for mode, each in row.items()} for trigger, row in actions.items()}
        self.actions = actions


def _lasting_s(table: config.Failsafe, trigger: AnyTrigger) -> float:
    """How long a trouble without an age of its own must last before the boat acts."""
    row: object = getattr(table, trigger.name.lower(), None)
    return row.after_s if isinstance(row, config.Trouble) and not isinstance(row, config.Silence) else 0.0


def _action(table: config.Failsafe, trigger: AnyTrigger, mode: Mode) -> Action:
    if trigger is Trigger.KILL:  # in idle, too: the worst of all that is shown
        return Action.STOP
    if trigger is Trigger.RESTARTED:  # its table says what the boat does once
        return Action.WARN
    if mode is Mode.IDLE:
        return Action.DISCONNECT if trigger is Trigger.THRUSTER and table.thruster.disconnect else Action.WARN
    if trigger is Trigger.CONTROL:
        return Action.STOP
    row: config.Trouble = getattr(table, trigger.name.lower())
    own: str = getattr(row, mode.name.lower(), "same")  # a mode of another boat of this process
    return Action[(row.action if own == "same" else own).upper()]


def failsafe(rules: Rules, memory: Memory, state: State, inputs: Inputs, now_s: float) -> Verdict:
    """Evaluate every trouble once."""
    look = Look(rules.settings, state, inputs, memory, now_s)
    found = troubles(look, rules.of_parts)
    if not found and not memory:
        return _WELL
    after = _remembered(rules, memory, found, now_s)
    worst, reason = Action.NONE, ""
    answers: list[tuple[Action, Notice]] = []
    for trigger in sorted(after):
        episode = after[trigger]
        if episode.acting_s == _NEVER_S:
            continue
        action, why = _answer(rules, trigger, episode, state, now_s)
        if action is Action.HOME:
            after[trigger] = episode._replace(answered=True)
        if action > worst:
            worst, reason = action, why
        answers.append((action, Notice(rules.names[trigger], why, episode.since_s, _DONE[action])))
    answers.sort(key=itemgetter(0), reverse=True)
    return Verdict(after, worst, reason, tuple([notice for _, notice in answers]))


def unsteered(action: Action) -> Action:
    """The action of a boat whose motors are not proven: with port and starboard exchanged a hold drives in circles."""
    return action if action < Action.HOLD else max(action, Action.STOP)


def fallback(action: Action, reason: str, has: frozenset[str], setpoint: Setpoint) -> tuple[Mode, str]:
    """The mode that does an action, or the next safer one whose inputs are there: home, hold, idle. And why."""
    cannot = None
    for mode in _DOES[action]:
        cannot = admit(mode, has, setpoint)
        if cannot is None:
            return mode, reason
    return Mode.IDLE, reason if cannot is None else f"{reason}; cannot hold: {cannot}"


def news(before: tuple[Notice, ...], after: tuple[Notice, ...]) -> list[str]:
    """The log lines for the change from one evaluation to the next."""
    known, present = {(n.name, n.action) for n in before}, {n.name for n in after}
    lines = [f"{n.name}: {n.reason}: {n.action}" for n in after if (n.name, n.action) not in known]
    return lines + [f"{n.name}: over" for n in before if n.name not in present]


def overruled(memory: Memory) -> Memory:
    """After an accepted command of the operator, present troubles no longer trigger HOME: the operator overruled them."""
    if not memory:
        return memory
    return {
        trigger: episode if episode.acting_s == _NEVER_S else episode._replace(answered=True)
        for trigger, episode in memory.items()
    }


def bits(notices: tuple[Notice, ...]) -> int:
    """The troubles as the log has them: bit n is trigger n."""
    return sum(1 << NUMBERS[notice.name] for notice in notices) if notices else 0


def _remembered(rules: Rules, memory: Memory, found: list[tuple[AnyTrigger, str]], now_s: float) -> dict[AnyTrigger, Episode]:
    """The memory with the troubles just found. One that has not lasted long enough is forgotten as soon as it is absent."""
    after = {}
    for trigger, reason in found:
        was = memory.get(trigger)
        since_s, acting_s, answered = (now_s, _NEVER_S, False) if was is None else (was.since_s, was.acting_s, was.answered)
        if acting_s == _NEVER_S and now_s - since_s >= rules.lasting_s[trigger]:
            acting_s = now_s
        after[trigger] = _new(Episode, (reason, since_s, now_s, acting_s, answered))
    for trigger, was in memory.items():
        if trigger not in after and was.acting_s != _NEVER_S and now_s - was.seen_s < rules.clear_s:
            after[trigger] = was
    return after


def _answer(rules: Rules, trigger: AnyTrigger, episode: Episode, state: State, now_s: float) -> tuple[Action, str]:
    """The action for one trouble now, and why. A trouble that is absent but not cleared yet is only reported."""
    action, why = rules.actions[trigger][state.mode], episode.reason
    if episode.seen_s != now_s:
        return Action.WARN, why
    if trigger is Trigger.THRUSTER and state.failed and not state.unsteerable:
        return Action.WARN, why  # the others carry on
    if action is Action.DISCONNECT and not state.overdue:
        return Action.WARN, why  # it was stopped just now and may still be coming to rest
    if action is not Action.HOME:
        return action, why
    if episode.answered or state.mode is Mode.HOME:
        return Action.WARN, why
    left_s = episode.acting_s + rules.pause_s - now_s
    return (Action.HOME, why) if left_s <= 0.0 else (Action.HOLD, f"{why}; home in {left_s:.0f} s")

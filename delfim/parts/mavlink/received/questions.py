"""Answers to what a console asks the boat about itself (`delfim.parts.mavlink.codec.questions`)."""

from collections.abc import Callable
from typing import Final

import msgspec

from delfim.base.input.unreadable import UNREADABLE
from delfim.parts.mavlink.codec import ownorders, questions
from delfim.parts.mavlink.codec.questions import BoatQuestion, ToldRow
from delfim.parts.mavlink.codec.wire import Message, Speaker
from delfim.parts.mavlink.consoles import Consoles
from delfim.vehicle import console


def answer(consoles: Consoles, source: Speaker, message: Message) -> Message:
    number, line = ownorders.numbered(message)
    try:
        asked = msgspec.json.decode(line, type=BoatQuestion)
    except UNREADABLE:
        return questions.told(source.party, number, ToldRow(refused="not understood"))
    return questions.told(source.party, number, ANSWERS[asked.of](consoles, source, asked))


def _settings(consoles: Consoles, source: Speaker, asked: BoatQuestion) -> ToldRow:
    keys = list(questions.changeable(type(consoles.boat.helm.filed)))
    return _setting(consoles, keys[asked.at], len(keys)) if asked.at < len(keys) else ToldRow(len(keys))


def _setting(consoles: Consoles, key: str, count: int, refused: str = "") -> ToldRow:
    now, allowed = consoles.boat.helm.settings, questions.changeable(type(consoles.boat.helm.filed))
    value, filed = questions.value_of(now, key), questions.value_of(consoles.boat.helm.filed, key)
    return ToldRow(count, key, value, filed, allowed[key], refused=refused)


def _change(consoles: Consoles, source: Speaker, asked: BoatQuestion) -> ToldRow:
    if asked.key not in questions.changeable(type(consoles.boat.helm.filed)):
        return ToldRow(refused="this cannot be changed while the boat runs")
    if asked.value is None:
        return _setting(consoles, asked.key, 0, "a value is wanted")
    value = ("yes" if asked.value else "no") if isinstance(asked.value, bool) else asked.value
    refused = consoles.ask(source, console.Set(asked.key, value))
    return _setting(consoles, asked.key, 0, refused or "")


def _checks(consoles: Consoles, source: Speaker, asked: BoatQuestion) -> ToldRow:
    """The same that the boat's own page shows at /checks."""
    checks = consoles.boat.helm.checks()
    if asked.at >= len(checks):
        return ToldRow(len(checks))
    found = checks[asked.at]
    words, refused = (found.reason, "") if found.ok else ("", found.reason)
    return ToldRow(len(checks), found.name[:100], words=words[:250], refused=refused[:250] or ("" if found.ok else "no"))


def _note(consoles: Consoles, source: Speaker, asked: BoatQuestion) -> ToldRow:
    """Who commands, and who has taken note of what, is in the boat's log, too."""
    consoles.boat.log.note(f"{source.name}: {asked.text}")
    return ToldRow()


ANSWERS: Final[dict[str, Callable[[Consoles, Speaker, BoatQuestion], ToldRow]]] = {
    "settings": _settings,
    "checks": _checks,
    "change": _change,
    "note": _note,
}

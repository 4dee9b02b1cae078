"""What a boat tells of itself: the keys that may change, the checks, over the real codecs and a radio that loses frames."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.errors import FormatError, Refused
from delfim.console.boats.questions import NO_ANSWER, WAITING_MAX, Questions
from delfim.console.link.mavlink import BoatQuestion, ToldRow
from delfim.console.terminal.describe import meaning
from delfim.parts.mavlink.codec import ownorders, questions
from delfim.vehicle import console
from tests.console.test_console_vehicle import Afloat

TEXT = st.text(max_size=250)


def listed(sea: Afloat, of: str) -> list[ToldRow]:
    ends: list[tuple[list[ToldRow], str]] = []
    sea.fleet.questions.read(1, of, lambda rows, why: ends.append((rows, why)))
    sea.run(200.0, until=lambda: ends)
    [(rows, why)] = ends
    assert why == ""
    assert len(rows) == rows[0].count
    return rows


def asked(sea: Afloat, question: BoatQuestion) -> ToldRow:
    told: list[ToldRow] = []
    sea.fleet.questions.ask(1, question, told.append)
    sea.run(30.0, until=lambda: told)
    return told[0]


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_a_key_is_changed_refused_with_the_reason_and_reverted(boat: Any, loss: float) -> None:
    sea = Afloat(boat, loss=loss)
    helm = sea.boat.vehicle.helm
    helm.settings = helm.filed
    sea.run(5.0)
    rows = {row.key: row for row in listed(sea, "settings")}
    assert list(rows) == list(questions.changeable(config.Vehicle))
    cruise = rows["control.speed.cruise_mps"]
    assert (cruise.value, cruise.file, cruise.allowed) == (cruise.file, helm.filed.control.speed.cruise_mps, "0.05 to 30.0")
    changed = asked(sea, BoatQuestion("change", key="control.speed.cruise_mps", value=0.7))
    assert (changed.value, changed.file, changed.refused) == (0.7, cruise.file, "")
    refused = asked(sea, BoatQuestion("change", key="control.speed.cruise_mps", value=99.0))
    assert (refused.value, "0.05 to 30.0" in refused.refused) == (0.7, True)
    word = asked(sea, BoatQuestion("change", key="failsafe.console_silent.action", value="dance"))
    assert "hold" in word.refused
    assert (
        asked(sea, BoatQuestion("change", key="boat.name", value="Alfa")).refused
        == "this cannot be changed while the boat runs"
    )
    asked(sea, BoatQuestion("change", key="log.required", value=False))
    assert helm.settings.log.required is False
    asked(sea, BoatQuestion("change", key="control.speed.cruise_mps", value=cruise.file))
    assert [row.key for row in listed(sea, "settings") if row.value != row.file] == ["log.required"]
    sets = [each for each in sea.obeyed if isinstance(each, console.Set)]
    assert [each.value for each in sets] == [0.7, "no", cruise.file], "each once, however often it was sent"


def test_the_checks_are_those_of_the_boats_own_page(boat: Any) -> None:
    sea = Afloat(boat)
    sea.run(2.0)
    checks = sea.boat.vehicle.helm.checks()
    assert [(row.key, not row.refused) for row in listed(sea, "checks")] == [(each.name, each.ok) for each in checks]


def test_who_commands_and_who_took_note_is_in_the_boats_own_log(boat: Any) -> None:
    sea = Afloat(boat, loss=0.3)
    sea.run(5.0)
    noted: list[str] = []
    sea.boat.vehicle.log.note = noted.append
    sea.fleet.note(None, "Ana: command: commands")
    sea.fleet.note(1, "Rui: acknowledged: fence ahead")
    sea.run(20.0)
    assert [each.partition(": ")[2] for each in noted] == ["Ana: command: commands", "Rui: acknowledged: fence ahead"]


def test_an_order_goes_before_questions_and_a_boat_that_says_nothing_is_told_of(boat: Any) -> None:
    sea = Afloat(boat)
    sea.run(2.0)
    sent: list[Any] = []
    busy = [True]
    waiting = Questions(lambda number, message: sent.append(message), lambda number: busy[0])
    told: list[ToldRow] = []
    waiting.ask(1, BoatQuestion("checks"), told.append)
    waiting.tick(0.0)
    assert not sent
    busy[0] = False
    waiting.tick(1.0)
    assert len(sent) == 1
    waiting.tick(21.1)
    assert told == [ToldRow(refused=NO_ANSWER)]
    for _ in range(WAITING_MAX):
        waiting.ask(1, BoatQuestion("checks"), told.append)
    with pytest.raises(Refused):
        waiting.ask(1, BoatQuestion("checks"), told.append)
    waiting.forget(1)
    assert len(told) == 1 + WAITING_MAX


@given(TEXT, TEXT, st.text(max_size=100))
def test_an_answer_fits_a_message_whatever_it_says(words: str, refused: str, key: str) -> None:
    number, row = questions.heard(
        questions.told((250, 190), 7, ToldRow(3, key.replace("\0", ""), words=words, refused=refused))
    )
    assert (number, row.count) == (7, 3)
    assert words.startswith(row.words)
    assert refused.startswith(row.refused)


@given(st.binary(max_size=240))
def test_what_is_no_answer_is_refused(data: bytes) -> None:
    message = ownorders.extension((1, 1), questions.TOLD, 5, data)
    try:
        questions.heard(message)
    except FormatError:
        return


def test_each_key_that_a_boat_offers_has_a_meaning() -> None:
    assert [key for key in questions.changeable(config.Vehicle) if not meaning(key)] == []

"""The watch: alarms stay while their cause lasts and until they are acknowledged, on every page; the log has who did what."""

import csv
import io
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from delfim.base.clock import ManualClock
from delfim.console.boats.alarms import ALARMS_MAX, Alarms, cause, is_trouble
from delfim.console.gateway.watchlog import HEADER, KEPT_MAX, WatchLine, WatchLog, table
from delfim.console.link.session import Session
from tests.console.test_gateway import opened

DEAD = "port propeller: no report for 1.0 s"


def told(alarms: Alarms) -> list[tuple[str, bool, bool]]:
    return [(each["text"], each["lasts"], each["seen"]) for each in alarms.shown()]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (f"idle: {DEAD}", f"{DEAD}: stop"),
        (f"{DEAD}: stop", "port propeller: no report for 64.0 s: warn"),
        ("depth 0.80 m, least 1.50 m: hold", "depth 0.75 m, least 1.50 m; home in 5 s: hold"),
    ],
)
def test_words_of_one_cause_are_one_alarm(one: str, other: str) -> None:
    assert cause(one) == cause(other)
    alarms = Alarms()
    alarms.hear(1, 2, one, 0.0)
    alarms.hear(1, 2, other, 1.0)
    alarms.hear(2, 2, other, 1.0)
    assert [each["boat"] for each in alarms.shown()] == [2, 1]


def test_an_alarm_lasts_while_its_cause_does_and_until_it_is_seen() -> None:
    alarms = Alarms()
    alarms.troubles(1, 0)
    alarms.hear(1, 4, f"{DEAD}: warn", 0.0, is_boats=True)
    alarms.troubles(1, 0b100)
    alarms.note([1])
    assert told(alarms) == [(f"{DEAD}: warn", True, True)], "it lasts"
    alarms.hear(1, 4, "depth 0.80 m: warn", 1.0, is_boats=True)
    alarms.troubles(1, 0b1100)
    alarms.troubles(1, 0b100)
    assert told(alarms) == [("depth 0.80 m: warn", False, False), (f"{DEAD}: warn", True, True)], "nobody has seen that it was"
    alarms.troubles(1, 0)
    alarms.note([each["id"] for each in alarms.shown()])
    assert told(alarms) == []


def test_what_becomes_graver_has_to_be_seen_again() -> None:
    alarms = Alarms()
    alarms.troubles(1, 1)
    alarms.hear(1, 4, f"{DEAD}: warn", 0.0, is_boats=True)
    alarms.note([1])
    alarms.hear(1, 2, f"{DEAD}: stop", 0.0, is_boats=True)
    assert told(alarms) == [(f"{DEAD}: stop", True, False)]


def test_grave_ones_are_not_pushed_off() -> None:
    alarms = Alarms()
    alarms.hear(1, 1, "on fire", 0.0)
    for n in range(2 * ALARMS_MAX):
        alarms.hear(1, 4, f"warning {chr(0x4E00 + n)}", float(n))
    assert len(alarms.shown()) == ALARMS_MAX
    assert alarms.shown()[0]["text"] == "on fire"


def test_a_boat_without_bits_has_alarms_until_they_are_seen() -> None:
    alarms = Alarms()
    alarms.hear(7, 2, "failsafe: battery", 0.0, is_boats=True)
    assert told(alarms) == [("failsafe: battery", False, False)]
    alarms.note([1])
    assert told(alarms) == []


@pytest.mark.parametrize(
    ("severity", "text", "is_so"),
    [
        (1, f"idle: {DEAD}", True),
        (4, f"{DEAD}: warn", True),
        (3, "a setting was refused by the disk", True),
        (4, "no mission is aboard", False),
        (3, "play refused: no mission loaded", False),
        (5, "idle: operator", False),
    ],
)
def test_a_refusal_is_no_alarm(severity: int, text: str, is_so: bool) -> None:
    assert (is_trouble(severity, text) and severity <= 4) == is_so


def test_the_log_is_bounded_and_a_table_that_no_spreadsheet_executes(tmp_path: Path) -> None:
    log = WatchLog()
    for n in range(KEPT_MAX + 10):
        log.put(WatchLine(1_790_000_000.5, 1, "=cmd()", "boat", "notice", f"line {n}, with a comma"))
    assert len(log.lines) == KEPT_MAX
    rows = list(csv.reader(io.StringIO(table(log.lines))))
    assert rows[0] == list(HEADER)
    assert rows[1] == ["2026-09-21T14:13:20.500Z", "1", "'=cmd()", "boat", "notice", "line 10, with a comma"]
    log.write(tmp_path / "no" / "such")
    assert "No such file" in log.reason
    log.write(tmp_path / "watch.csv")
    log.put(log.lines[0])
    log.write(tmp_path / "watch.csv")
    assert (tmp_path / "watch.csv").read_text().count("time,boat") == 1
    assert log.reason == ""


async def test_a_page_that_opens_hears_what_was_and_one_page_acknowledges_for_all(tmp_path: Path) -> None:
    sessions = tmp_path / "sessions"
    async with opened(tmp_path, sessions=sessions) as sea:
        async with sea.session.ws_connect(sea.url + "ws") as page:
            await sea.until(page, lambda m: m["t"] == "boats" and len(m["boats"]) == 2)
            sea.boats[0].say(mavlink.MAVLink_statustext_message(2, b"port propeller blocked: stop", 0, 0))
            await sea.until(page, lambda m: m["t"] == "alarms" and m["alarms"])
            sea.boats[1].refuse = "not now"
            await page.send_json({"t": "command", "seq": 1, "boat": 2, "command": "play", "leg": 3})
            await sea.until(page, lambda m: m["t"] == "answer" and not m["ok"])
        async with sea.session.ws_connect(sea.url + "ws") as page:
            log = await sea.until(page, lambda m: m["t"] == "log")
            lines = [(each["boat"], each["what"], each["text"]) for each in log["lines"]]
            assert (1, "alarm", "port propeller blocked: stop") in lines
            assert (2, "order", "play leg=3") in lines
            assert (2, "refused", "play leg=3: not now") in lines
            alarms = (await sea.until(page, lambda m: m["t"] == "alarms"))["alarms"]
            worst: dict[str, Any] = alarms[0]
            assert (worst["text"], worst["seen"]) == ("port propeller blocked: stop", False)
            async with sea.session.ws_connect(sea.url + "ws") as other:
                await other.send_json({"t": "acknowledge", "seq": 2, "ids": [each["id"] for each in alarms]})
                await sea.until(page, lambda m: m["t"] == "alarms" and not m["alarms"])
        async with sea.session.get(sea.url + "watch.csv") as answer:
            rows = list(csv.reader(io.StringIO(await answer.text())))
        assert [row[3] for row in rows if row[4] == "acknowledged"] == ["page 3 at 127.0.0.1"] * len(alarms)
    [frames], [kept] = sessions.glob("*.tlog"), sessions.glob("*.csv")
    assert frames.stem == kept.stem
    assert "play leg=3: not now" in kept.read_text()


def test_the_file_is_that_of_the_session(tmp_path: Path) -> None:
    session = Session(tmp_path, ManualClock(100.0))
    session.put(b"frame")
    assert session.tick()
    assert not session.tick(), "once a second"

"""The watch: alerts stay while their cause lasts and until they are acknowledged, on every page; the log has who did what."""

import csv
import io
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from delfim.__main__ import main
from delfim.base.clock import ManualClock
from delfim.console.gateway.watchlog import HEADER, KEPT_MAX, WatchLine, WatchLog, since, table
from delfim.console.link.session import Session
from delfim.console.watch.alerts import (
    HISTORY_MAX,
    MORE,
    OF_BOAT,
    SILENCE_S,
    UNTOLD_S,
    AlertList,
    KeptAlerts,
    cause,
    is_trouble,
)
from delfim.console.watch.alertstate import UNSEEN, AlertState, Happening, Priority, after
from tests.console.test_gateway import opened

DEAD = "port propeller: no report for 1.0 s"
NOTED = {Happening.ACKNOWLEDGED, Happening.TRANSFERRED}


def alert_list() -> AlertList:
    return AlertList(lambda: 0.0)


def told(alerts: AlertList) -> list[tuple[str, str]]:
    return [(each["text"], each["state"]) for each in alerts.shown()]


@pytest.mark.parametrize("priority", list(Priority))
@pytest.mark.parametrize("happening", list(Happening))
@pytest.mark.parametrize("state", list(AlertState))
def test_what_nobody_has_seen_stays_unseen_until_somebody_takes_note(
    state: AlertState, happening: Happening, priority: Priority
) -> None:
    to = after(state, happening, priority)
    if priority is Priority.CAUTION:
        return
    if state in UNSEEN and happening not in NOTED:
        assert to in UNSEEN
    if state is not AlertState.NORMAL and to is AlertState.NORMAL:
        assert (state, happening) in {
            (AlertState.RECTIFIED, Happening.ACKNOWLEDGED),
            (AlertState.ACKNOWLEDGED, Happening.ENDS),
            (AlertState.TRANSFERRED, Happening.ENDS),
        }
    if happening is Happening.BEGINS:
        assert to is AlertState.UNACKNOWLEDGED
    if priority is Priority.EMERGENCY:
        assert to is not AlertState.SILENCED or state is AlertState.SILENCED


@given(st.lists(st.sampled_from(list(Happening))), st.sampled_from(list(Priority)))
def test_each_state_is_what_its_last_happenings_mean(happenings: list[Happening], priority: Priority) -> None:
    """A second account of the states, by what is known and not by a table."""
    state, lasts, is_noted, is_quiet, is_transferred = AlertState.NORMAL, False, True, False, False
    for each in happenings:
        state = after(state, each, priority)
        if each is Happening.BEGINS:
            lasts, is_noted, is_quiet, is_transferred = True, priority is Priority.CAUTION, False, False
        elif each is Happening.ENDS:
            lasts = is_quiet = False
        elif priority is Priority.CAUTION:
            continue
        elif each is Happening.ACKNOWLEDGED:
            is_noted, is_quiet = True, False
        elif each is Happening.TRANSFERRED and lasts:
            is_noted = is_transferred = True
            is_quiet = False
        elif each is Happening.RETURNED and lasts and is_transferred:
            is_noted = is_transferred = False
        elif each in (Happening.SILENCED, Happening.LOUD) and lasts and not is_noted:
            is_quiet = each is Happening.SILENCED and priority is not Priority.EMERGENCY
        if is_noted:
            meant = AlertState.NORMAL if not lasts else AlertState.TRANSFERRED if is_transferred else AlertState.ACKNOWLEDGED
        else:
            meant = AlertState.RECTIFIED if not lasts else AlertState.SILENCED if is_quiet else AlertState.UNACKNOWLEDGED
        assert state is meant, happenings


DEEDS = st.one_of(
    st.tuples(st.just("hear"), st.integers(1, 3), st.integers(0, 4), st.integers(0, 60)),
    st.tuples(st.just("troubles"), st.integers(1, 3), st.integers(0, 7), st.just(0)),
    st.tuples(st.just("hold"), st.integers(1, 3), st.integers(0, 1), st.just(0)),
    st.tuples(st.just("acknowledge"), st.just(0), st.integers(0, 40), st.just(0)),
    st.tuples(st.just("silence"), st.just(0), st.integers(0, 40), st.just(0)),
    st.tuples(st.just("transfer"), st.just(0), st.just(0), st.just(0)),
    st.tuples(st.just("give_back"), st.just(0), st.just(0), st.just(0)),
    st.tuples(st.just("restart"), st.just(0), st.just(0), st.just(0)),
    st.tuples(st.just("later"), st.just(0), st.integers(1, 40), st.just(0)),
)


@given(st.lists(DEEDS, max_size=150))
def test_nothing_that_nobody_has_seen_is_lost_whatever_happens(deeds: list[tuple[str, int, int, int]]) -> None:
    now_s = [0.0]
    alerts = AlertList(lambda: now_s[0])
    unseen = set[tuple[int, str]]()  # by boat and words, that must be in the list, or be covered by MORE of that boat
    for deed, boat, number, word in deeds:
        if deed == "hear":
            text = f"trouble {chr(0x4E00 + word)}"
            before = {(each["boat"], each["text"]): each for each in alerts.shown()}.get((boat, text))
            alerts.hear(boat, number, text, is_boats=bool(word % 2))
            after_it = {(each["boat"], each["text"]): each for each in alerts.shown()}.get((boat, text))
            if before is None or (after_it is not None and after_it["id"] != before["id"]):
                unseen.add((boat, text))
        elif deed == "troubles":
            was = {each["id"] for each in alerts.shown()}
            alerts.troubles(boat, number)
            unseen |= {(each["boat"], each["text"]) for each in alerts.shown() if each["id"] not in was}
        elif deed == "hold":
            if alerts.hold(boat, 4, "link lost", bool(number)) and number:
                unseen.add((boat, "link lost"))
        elif deed == "acknowledge":
            for each in alerts.acknowledge("Ana", [number]):
                assert each.boat is not None
                unseen = {key for key in unseen if key != (each.boat, each.text)}
                if each.text == MORE:
                    unseen = {key for key in unseen if key[0] != each.boat or key in standing(alerts)}
        elif deed == "transfer":
            taken = {(each.boat, each.text) for each in alerts.transfer("Rui")}
            unseen = {key for key in unseen if key not in taken}
            unseen = {key for key in unseen if (key[0], MORE) not in taken or key in standing(alerts)}
        elif deed == "give_back":
            alerts.give_back()
        elif deed == "restart":
            alerts = started_again(alerts, lambda: now_s[0])
        elif deed == "later":
            now_s[0] += number
            alerts.tick()
        else:
            alerts.silence("Ana", [number])
        shown = {(each["boat"], each["text"]) for each in alerts.shown() if AlertState(each["state"]) in UNSEEN}
        for key in unseen:
            assert key in shown or (key[0], MORE) in shown, (deed, key)
        assert all(sum(each["boat"] == b for each in alerts.shown()) <= OF_BOAT + 2 for b in (1, 2, 3))
    assert len(alerts.history) <= HISTORY_MAX


def started_again(alerts: AlertList, utc_s: Callable[[], float]) -> AlertList:
    """The console ended, and another one read what it had kept."""
    after_it = AlertList(utc_s)
    after_it.restore(msgspec.json.decode(msgspec.json.encode(alerts.kept()), type=KeptAlerts))
    return after_it


def standing(alerts: AlertList) -> set[tuple[int, str]]:
    return {(each["boat"], each["text"]) for each in alerts.shown()}


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (f"idle: {DEAD}", f"{DEAD}: stop"),
        (f"{DEAD}: stop", "port propeller: no report for 64.0 s: warn"),
        ("depth 0.80 m, least 1.50 m: hold", "depth 0.75 m, least 1.50 m; home in 5 s: hold"),
    ],
)
def test_words_of_one_cause_are_one_alert(one: str, other: str) -> None:
    assert cause(one) == cause(other)
    alerts = alert_list()
    alerts.hear(1, 2, one)
    alerts.hear(1, 2, other)
    alerts.hear(2, 2, other)
    assert [each["boat"] for each in alerts.shown()] == [2, 1]


def test_an_alert_lasts_while_its_cause_does_and_until_it_is_seen() -> None:
    alerts = alert_list()
    alerts.troubles(1, 0)
    alerts.hear(1, 4, f"{DEAD}: warn", is_boats=True)
    alerts.troubles(1, 0b100)
    alerts.acknowledge("Ana", [1])
    assert told(alerts) == [(f"{DEAD}: warn", "acknowledged")], "it lasts"
    alerts.hear(1, 4, "depth 0.80 m: warn", is_boats=True)
    alerts.troubles(1, 0b1100)
    alerts.troubles(1, 0b100)
    assert told(alerts) == [("depth 0.80 m: warn", "rectified"), (f"{DEAD}: warn", "acknowledged")], "nobody has seen it"
    alerts.troubles(1, 0)
    alerts.acknowledge("Rui", [each["id"] for each in alerts.shown()])
    assert told(alerts) == []
    assert [(each["text"], each["by"]) for each in alerts.history] == [(f"{DEAD}: warn", "Ana"), ("depth 0.80 m: warn", "Rui")]


def test_what_becomes_graver_has_to_be_seen_again() -> None:
    alerts = alert_list()
    alerts.troubles(1, 1)
    alerts.hear(1, 4, f"{DEAD}: warn", is_boats=True)
    alerts.acknowledge("Ana", [1])
    alerts.hear(1, 2, f"{DEAD}: stop", is_boats=True)
    assert told(alerts) == [(f"{DEAD}: stop", "unacknowledged")]
    assert alerts.shown()[0]["priority"] == "alarm"


def test_what_comes_again_has_to_be_seen_again() -> None:
    alerts = alert_list()
    for is_so in (True, False, True):
        alerts.hold(1, 4, "link lost", is_so)
    assert told(alerts) == [("link lost", "unacknowledged")]


def test_a_caution_comes_and_goes_with_its_cause() -> None:
    alerts = alert_list()
    alerts.hold(1, 5, "link weak", True)
    assert (told(alerts), alerts.shown()[0]["sounds"]) == ([("link weak", "acknowledged")], False)
    alerts.hold(1, 5, "link weak", False)
    assert told(alerts) == []
    assert alerts.history[0]["text"] == "link weak"


def test_a_silence_ends_and_takes_no_note() -> None:
    now_s = [100.0]
    alerts = AlertList(lambda: now_s[0])
    alerts.hold(1, 2, "port propeller blocked", True)
    alerts.hear(1, 0, "sinking")
    silenced = alerts.silence("Ana", [1, 2])
    assert [each.text for each in silenced] == ["port propeller blocked"], "an emergency is not silenced"
    alerts.hold(1, 2, "port propeller blocked", False)
    alerts.hold(1, 2, "port propeller blocked", False)
    assert [(each["text"], each["state"], each["sounds"]) for each in alerts.shown()] == [
        ("sinking", "unacknowledged", True),
        ("port propeller blocked", "rectified", False),
    ]
    now_s[0] += SILENCE_S
    alerts.changed = False
    alerts.tick()
    assert alerts.changed
    assert [each["sounds"] for each in alerts.shown()] == [True, True]


def test_who_takes_over_answers_for_what_lasts_until_nobody_does() -> None:
    alerts = alert_list()
    alerts.hold(1, 2, "port propeller blocked", True)
    alerts.hold(2, 4, "link lost", True)
    alerts.hold(2, 4, "link lost", False)
    alerts.acknowledge("Ana", [1])
    alerts.transfer("Rui")
    assert told(alerts) == [("link lost", "rectified"), ("port propeller blocked", "transferred")]
    assert [each["by"] for each in alerts.shown()] == ["", "Rui"]
    alerts.give_back()
    assert told(alerts) == [("port propeller blocked", "unacknowledged"), ("link lost", "rectified")]


def test_nothing_is_pushed_off_and_what_is_too_much_is_one_more() -> None:
    alerts = alert_list()
    alerts.hear(1, 1, "on fire")
    for n in range(1000):
        alerts.hear(1, 4 - n % 2, f"trouble {chr(0x4E00 + n)}")
    alerts.hear(2, 4, "link lost")
    of_first = [each["text"] for each in alerts.shown() if each["boat"] == 1]
    assert len(of_first) == OF_BOAT + 1
    assert {"on fire", MORE} <= set(of_first)
    assert alerts.shown()[0]["text"] == MORE, "the newest of the gravest"
    assert "link lost" in {each["text"] for each in alerts.shown()}


def test_a_boat_without_bits_has_alerts_until_they_are_seen() -> None:
    alerts = alert_list()
    alerts.hear(7, 2, "failsafe: battery", is_boats=True)
    assert told(alerts) == [("failsafe: battery", "unacknowledged")]
    alerts.acknowledge("Ana", [1])
    assert told(alerts) == []


def test_a_trouble_whose_words_were_lost_is_an_alert_once() -> None:
    now_s = [0.0]
    alerts = AlertList(lambda: now_s[0])
    alerts.troubles(1, 1 << 10)
    now_s[0] = UNTOLD_S - 0.1
    alerts.troubles(1, 1 << 10)
    assert told(alerts) == [], "its words may still come"
    for now_s[0] in (UNTOLD_S, UNTOLD_S + 60.0):
        alerts.troubles(1, 1 << 10)
        assert told(alerts) == [("fence: the boat's words were lost on the link", "unacknowledged")]
    alerts.acknowledge("Ana", [1])
    alerts.troubles(1, 1 << 10)
    assert told(alerts) == [("fence: the boat's words were lost on the link", "acknowledged")]
    alerts.troubles(1, 0)
    assert told(alerts) == []


def test_a_trouble_that_was_told_is_no_second_alert_even_before_its_first_bits() -> None:
    now_s = [0.0]
    alerts = AlertList(lambda: now_s[0])
    alerts.hear(1, 2, f"{DEAD}: stop", is_boats=True)
    for now_s[0] in (1.0, 100.0):
        alerts.troubles(1, 1 << 6)
    assert told(alerts) == [(f"{DEAD}: stop", "unacknowledged")]


def test_alerts_come_back_as_they_were_with_their_first_times() -> None:
    now_s = [100.0]
    alerts = AlertList(lambda: now_s[0])
    alerts.troubles(1, 0)
    for boat, text in ((1, f"{DEAD}: stop"), (2, "fence left: stop"), (3, "shallow: hold")):
        alerts.hear(boat, 2, text, is_boats=True)
    alerts.troubles(1, 1 << 6)
    alerts.hold(None, 4, "recording of the session: the disk is full", True)
    alerts.hold(2, 4, "link lost", True)
    ids = {each["text"]: each["id"] for each in alerts.shown()}
    alerts.acknowledge("Ana", [ids["link lost"]])
    alerts.transfer("Rui")
    alerts.acknowledge("Ana", [ids[f"{DEAD}: stop"], ids["shallow: hold"]])
    now_s[0] = 500.0
    again = started_again(alerts, lambda: now_s[0])
    assert {each["text"]: each["state"] for each in again.shown()} == {
        f"{DEAD}: stop": "acknowledged",
        "fence left: stop": "unacknowledged",
        "link lost": "unacknowledged",  # nobody commands after a restart
        "recording of the session: the disk is full": "rectified",
    }
    assert {each["at_s"] for each in again.shown()} == {100.0}
    assert [each["text"] for each in again.history] == ["shallow: hold"]
    again.hear(3, 2, "a new one: stop")
    assert max(each["id"] for each in again.shown()) > max(ids.values()), "no number comes twice"
    again.troubles(1, 0)
    assert f"{DEAD}: stop" not in [each["text"] for each in again.shown()]


def test_a_forgotten_boat_takes_its_alerts_into_the_history() -> None:
    alerts = alert_list()
    alerts.hold(1, 4, "link lost", True)
    alerts.forget(1, "Ana")
    assert [(each["text"], each["by"]) for each in alerts.history] == [("link lost", "Ana")]
    for _, boat in itertools.product(range(HISTORY_MAX), (1, 2)):
        alerts.hold(boat, 4, "link lost", True)
        alerts.forget(boat, "Ana")
    assert len(alerts.history) == len(alerts.ended) == HISTORY_MAX


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
            await sea.until(page, lambda m: m["t"] == "alerts" and m["alerts"])
            sea.boats[1].refuse = "not now"
            await page.send_json({"t": "command", "seq": 1, "boat": 2, "command": "play", "leg": 3})
            await sea.until(page, lambda m: m["t"] == "answer" and not m["ok"])
        async with sea.session.ws_connect(sea.url + "ws") as page:
            log = await sea.until(page, lambda m: m["t"] == "log")
            lines = [(each["boat"], each["what"], each["text"]) for each in log["lines"]]
            assert (1, "alarm", "port propeller blocked: stop") in lines
            assert (2, "order", "play leg=3") in lines
            assert (2, "refused", "play leg=3: not now") in lines
            assert (await sea.until(page, lambda m: m["t"] == "ended"))["alerts"] == []
            alerts = (await sea.until(page, lambda m: m["t"] == "alerts"))["alerts"]
            worst: dict[str, Any] = alerts[0]
            assert (worst["text"], worst["state"]) == ("port propeller blocked: stop", "unacknowledged")
            async with sea.session.ws_connect(sea.url + "ws") as other:
                await other.send_json({"t": "quiet", "seq": 1, "ids": [worst["id"]]})
                silent = await sea.until(page, lambda m: m["t"] == "alerts" and not m["alerts"][0]["sounds"])
                assert silent["alerts"][0]["state"] == "silenced"
                await other.send_json({"t": "acknowledge", "seq": 2, "ids": [each["id"] for each in alerts]})
                ended = await sea.until(page, lambda m: m["t"] == "ended" and m["alerts"])
                assert [each["by"] for each in ended["alerts"]] == ["page 3 at 127.0.0.1"] * len(alerts)
                await sea.until(page, lambda m: m["t"] == "alerts" and not m["alerts"])
        async with sea.session.get(sea.url + "watch.csv") as answer:
            rows = list(csv.reader(io.StringIO(await answer.text())))
        assert [row[3] for row in rows if row[4] == "acknowledged"] == ["page 3 at 127.0.0.1"] * len(alerts)
    [frames], [kept] = sessions.glob("*.tlog"), sessions.glob("*.csv")
    assert frames.stem == kept.stem
    assert "play leg=3: not now" in kept.read_text()


def test_a_watch_goes_on_with_the_lines_of_the_sessions_before(tmp_path: Path) -> None:
    hard = ["=cmd()", "two\nlines, and a comma", "'quoted'", "plain"]
    for n, name in enumerate(("20260921-100000", "20260921-110000", "20260921-110000-1")):
        log = WatchLog()
        for text in hard:
            log.put(WatchLine(1_790_000_000.0 + 3600 * n, 1, "boat1", "Ana", "order", f"{text} {n}"))
        log.write(tmp_path / f"{name}.csv")
    with (tmp_path / "20260921-110000.csv").open("a") as out:
        out.write("half a li")
    (tmp_path / "soundings.csv").write_text("not of the watch")
    log = WatchLog()
    log.resume(tmp_path)
    assert [line.text for line in log.lines] == [f"{text} {n}" for n in range(3) for text in hard]
    assert [round(line.at_s) for line in since(tmp_path, 1_790_003_600.0)] == [1_790_003_600] * 4 + [1_790_007_200] * 4
    log.write(tmp_path / "new.csv")
    assert not (tmp_path / "new.csv").exists(), "each line is in one table"
    assert main(["console", "--sessions", str(tmp_path), "--watch-log", "1e9"]) == 0


async def test_alerts_and_log_outlive_the_console(tmp_path: Path) -> None:
    sessions = tmp_path / "sessions"
    async with opened(tmp_path, sessions=sessions) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        await sea.until(page, lambda m: m["t"] == "boats" and len(m["boats"]) == 2)
        for boat, words in ((0, b"port propeller blocked: stop"), (1, b"fence left: stop")):
            sea.boats[boat].say(mavlink.MAVLink_statustext_message(2, words, 0, 0))
        first = (await sea.until(page, lambda m: m["t"] == "alerts" and len(m["alerts"]) == 2))["alerts"]
        await page.send_json({"t": "acknowledge", "seq": 2, "ids": [first[0]["id"]]})
        await sea.until(page, lambda m: m["t"] == "alerts" and len(m["alerts"]) == 1)
    async with opened(tmp_path, sessions=sessions) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        lines = (await sea.until(page, lambda m: m["t"] == "log"))["lines"]
        assert ("acknowledged", first[0]["text"]) in [(each["what"], each["text"]) for each in lines]
        assert [each["text"] for each in (await sea.until(page, lambda m: m["t"] == "ended"))["alerts"]] == [first[0]["text"]]
        [left] = (await sea.until(page, lambda m: m["t"] == "alerts"))["alerts"]
        assert left == first[1]
        await page.send_json({"t": "acknowledge", "seq": 3, "ids": [left["id"]]})
        await sea.until(page, lambda m: m["t"] == "ended" and m["alerts"][0]["text"] == left["text"])


async def test_a_damaged_file_of_alerts_is_told_and_put_aside(tmp_path: Path) -> None:
    (tmp_path / "alerts.json").write_text('{"last": "many"}')
    async with opened(tmp_path, sessions=tmp_path) as sea, sea.session.ws_connect(sea.url + "ws") as page:
        told_ = await sea.until(page, lambda m: m["t"] == "alerts" and m["alerts"])
        assert "the alerts of the session before are lost" in told_["alerts"][0]["text"]
    assert (tmp_path / "alerts.damaged").exists()


def test_the_file_is_that_of_the_session(tmp_path: Path) -> None:
    session = Session(tmp_path, ManualClock(100.0))
    session.put(b"frame")
    assert session.tick()
    assert not session.tick(), "once a second"

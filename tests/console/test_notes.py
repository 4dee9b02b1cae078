"""What operators note: in the log of the watch, on the time line of a later replay, and noted there again."""

import asyncio
from pathlib import Path
from typing import Any

from delfim.console.gateway.watchlog import since
from delfim.console.tapes.replay import open_tapes
from tests.console.test_gateway import boat_in, opened


def test_a_note_is_kept_and_shown_in_the_replay_and_one_on_the_replay_is_kept_at_its_own_time(tmp_path: Path) -> None:
    sessions = tmp_path / "sessions"

    async def at_sea() -> dict[str, Any]:
        async with opened(tmp_path, sessions=sessions) as sea, sea.session.ws_connect(sea.url + "ws") as page:
            now_s = (await sea.until(page, lambda m: m["t"] == "boats" and boat_in(m, 1)))["at_s"]
            await page.send_json({"t": "note", "seq": 1, "boat": 1, "text": "=weed", "at_s": now_s + 9e9})
            (line,) = (await sea.until(page, lambda m: m["t"] == "log" and m["lines"][-1]["what"] == "note"))["lines"]
            assert (line["boat"], line["text"], line["who"].split()[0]) == (1, "=weed", "page")
            assert line["at_s"] < now_s + 60.0, "no note is of a time to come"
            assert (await sea.until(page, lambda m: m["t"] == "answer"))["ok"]
            for text in ("", "x" * 201):
                await page.send_json({"t": "note", "seq": 2, "boat": 1, "text": text})
                assert not (await sea.until(page, lambda m: m["t"] == "answer"))["ok"]
            await sea.until(page, lambda m: m["t"] == "boats" and m["at_s"] > line["at_s"] + 1.0)
            sea.boats[0].tick()
            await sea.until(page, lambda m: boat_in(m, 1) and boat_in(m, 1)["age_s"]["heard"] < 0.5)
            return dict(line)

    async def again(notes: list[str], new: str) -> None:
        tapes = open_tapes([sessions])
        async with opened(tmp_path, tapes=tapes, sessions=sessions) as sea, sea.session.ws_connect(sea.url + "ws") as page:
            replay = (await page.receive_json())["replay"]
            assert [each["text"].partition(": ")[2] for each in replay["events"] if each.get("note")] == notes
            log = await sea.until(page, lambda m: m["t"] == "log")
            assert {line["what"] for line in log["lines"]} >= {"note", "page"}, "of that time"
            await page.send_json({"t": "note", "seq": 1, "boat": 2, "text": new, "at_s": replay["from_s"]})
            assert (await sea.until(page, lambda m: m["t"] == "answer"))["ok"]

    noted = asyncio.run(at_sea())
    asyncio.run(again(["=weed"], "late"))
    asyncio.run(again(["late", "=weed"], "later"))
    kept = [line for line in since(sessions, 0.0) if line.what == "note"]
    assert {line.text for line in kept} == {"=weed", "late", "later"}
    assert all(line.at_s <= noted["at_s"] for line in kept), "at the time that the replay showed"

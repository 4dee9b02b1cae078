"""The last ten minutes of the selected boat at the foot of the page."""

from tests.console.scenes import at_work, choose
from tests.console.standin import Message, Standin
from tests.kit.page import sailing, shown


def line(gateway: Standin, number: int | None, who: str, what: str, text: str) -> Message:
    """Of the log of the watch."""
    return {"at_s": gateway.at_s, "boat": number, "name": "", "who": who, "what": what, "text": text}


async def test_the_last_ten_minutes_have_values_changes_of_mode_and_messages_and_nothing_older() -> None:
    gateway = at_work()
    async with sailing(gateway) as page:
        await page.press("Tab")
        await page.mouse((700.0, 120.0))
        await choose(page, "Screen", "The last ten minutes")
        told = gateway.boat(2)
        marks = "[...document.querySelectorAll('#timeline .marks i')].map((each) => each.title.slice(9)).join()"
        for depth_m in (4.0, 5.0, 6.0):
            told["measured"] = {"depth_m": {"value": depth_m, "age_s": 0.1}}
            await gateway.frame(2.0)
        for number, who, what, said in ((2, "boat", "warning", "guest silent"), (1, "boat", "warning", "of the other")):
            await gateway.tell({"t": "log", "lines": [line(gateway, number, who, what, said)]})
        told["mode"] = "hold"
        await gateway.frame(2.0)
        await shown(page, gateway, f"{marks} === 'guest silent,hold'")
        values = "[...document.querySelectorAll('#timeline figcaption')].map((each) => each.textContent).join()"
        await shown(page, gateway, f"{values}.includes('depth 6.0 m  (4 to 6)') && {values}.includes('speed')")
        told["measured"] = {}
        for _ in range(2):
            await gateway.frame(301.0)
        await shown(page, gateway, f"{marks} === '' && !{values}.includes('depth')")
        await page.mouse((420.0, 120.0))  # beside the messages
        await choose(page, "Screen", "The last ten minutes")
        await shown(page, gateway, "document.getElementById('timeline').hidden")
        await page.nothing_amiss()


async def test_an_order_and_a_note_are_marks_too_and_a_note_is_said_by_a_key_with_the_time_of_the_key() -> None:
    gateway = at_work()
    async with sailing(gateway) as page:
        await page.press("Tab")
        await page.mouse((700.0, 120.0))
        await choose(page, "Screen", "The last ten minutes")
        await gateway.frame()
        before_s = gateway.at_s
        await page.press("j")
        await page.until("document.activeElement.matches('.popup .name')")
        await page.call("Input.insertText", text="weed-here")
        await gateway.frame(30.0)
        await page.press("Enter")
        said = await gateway.until(lambda m: m["t"] == "note")
        assert (said["boat"], said["text"]) == (2, "weed here")
        assert said["at_s"] < before_s + 15.0
        lines = [line(gateway, 2, "Ana", "order", "speed"), line(gateway, None, "Ana", "note", "rain")]
        await gateway.tell({"t": "log", "lines": lines})
        each = "each.dataset.severity + each.title.slice(8)"
        marks = f"[...document.querySelectorAll('#timeline .marks i')].map((each) => {each}).join()"
        await shown(page, gateway, f"{marks} === 'notice Ana: speed,note Ana: rain'")
        await page.nothing_amiss()


async def test_in_a_replay_a_note_is_a_mark_at_once_and_may_have_spaces() -> None:
    gateway = at_work()
    events = [{"at_s": gateway.at_s - 50, "boat": 2, "severity": 6, "text": "Ana: weed", "note": True}]
    gateway.hello["replay"] = {"from_s": gateway.at_s - 100, "to_s": gateway.at_s + 100, "events": events}
    async with sailing(gateway) as page:
        await page.press("j")
        await page.until("document.activeElement.matches('.popup .name')")
        await page.press(" ")
        await page.call("Input.insertText", text="more weed-here")
        await page.press("Enter")
        assert (await gateway.until(lambda m: m["t"] == "note"))["text"] == "more weed-here"
        assert not [each for each in gateway.said if each["t"] == "replay"], "it played on"
        await gateway.tell({"t": "log", "lines": [line(gateway, 2, "Ana", "note", "more weed-here")]})
        marks = (
            "[...document.querySelectorAll('#replay .marks [data-severity=note]')].map((each) => each.title.slice(9)).join()"
        )
        await shown(page, gateway, f"{marks} === 'Ana: weed,Ana: more weed-here'")
        await page.nothing_amiss()

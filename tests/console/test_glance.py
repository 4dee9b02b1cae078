"""What an operator sees of the boats at a glance, in a real browser against a stand-in gateway: on a desk, on a phone."""

import asyncio
import contextlib
import json
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.console.scenes import at_work, choose, opened, show, survey, waypoints
from tests.console.standin import Message, Standin, boat, place, reference
from tests.kit.page import shown, text_of, two
from tests.services.browser import Page, shrink, tab

DESK, PHONE, LANDSCAPE = (1440, 860), (390, 844), (844, 390)


@contextlib.asynccontextmanager
async def look(gateway: Standin, size: tuple[int, int], *, touch: bool = False) -> AsyncIterator[tuple[Page, Standin]]:
    """The page open in a window of this size."""
    async with gateway.serving(), tab() as page:
        await page.call("Emulation.setTouchEmulationEnabled", enabled=touch)
        await opened(page, gateway, width=size[0], height=size[1])
        yield page, gateway
        assert page.complaints == []


async def test_a_hull_is_to_scale_where_that_is_more_than_its_symbol() -> None:
    async with look(
        Standin([boat(1, "Delfim", "#f4f6f7") | {"size": {"length_m": 4.5, "beam_m": 2.45, "rpm_max": 1200.0}}]), DESK
    ) as (
        page,
        gateway,
    ):
        for half_m in (200.0, 10.0):
            await show(page, -half_m, -half_m, half_m, half_m)
            await gateway.frame()
            ends = [
                f"delfim.pixel({latitude_deg}, {longitude_deg})[1]"
                for latitude_deg, longitude_deg in (place(-2.25, 0), place(2.25, 0))
            ]
            length_px = await page.value(f"{ends[0]} - {ends[1]}")
            assert await page.value("delfim.long(1)") == pytest.approx(length_px if half_m < 100.0 else 0.0, rel=0.01)
        gateway.boat(1)["heading_deg"] = None
        await gateway.frame()
        await shown(page, gateway, "delfim.long(1) === 0")


@pytest.mark.parametrize("size", [pytest.param(DESK, id="desk"), pytest.param(PHONE, id="phone", marks=pytest.mark.long)])
async def test_a_weak_link_is_amber_with_its_cause_and_with_what_it_means_for_a_stop(size: tuple[int, int]) -> None:
    async with look(Standin(two()), size) as (page, gateway):
        weak = "document.querySelector('[data-boat=\"1\"] .weak')"
        bars = "document.querySelector('[data-boat=\"1\"] .bars')"
        for link, words, count in (
            ({"rtt_ms": 3.2, "loss_pct": 0.0}, "", "4"),
            ({"rtt_ms": 600.0, "loss_pct": 4.0}, "", "3"),
            ({"rtt_ms": 3.2, "loss_pct": 10.0}, "link weak: 10 % lost; a stop may take 1\u00a0s", "2"),
            ({"rtt_ms": 1000.0, "loss_pct": 0.0}, "link weak: 1.0 s round trip; a stop may take 2\u00a0s", "2"),
            ({"rtt_ms": 1600.0, "loss_pct": 35.0}, "link weak: 35 % lost, 1.6 s round trip; a stop may take 3\u00a0s", "1"),
            ({"rtt_ms": None, "loss_pct": 80.0}, "link weak: 80 % lost; a stop may take 7\u00a0s", "1"),
        ):
            gateway.boat(1)["link"].update(link)
            await shown(page, gateway, f"{text_of(1, '.weak')} === {json.dumps(words)} && {bars}.dataset.bars === '{count}'")
            assert await page.value(f"{bars}.getClientRects().length") == 1
            assert await page.value(f"{weak}.getClientRects().length") == bool(words)
        gateway.boat(1)["age_s"]["heard"] = 9.0
        await shown(page, gateway, f"{bars}.dataset.bars === '0'")
        gateway.boat(1)["link"].update(kind="log")
        await shown(page, gateway, f"{bars}.hidden && {text_of(1, '.weak')} === ''")


async def test_the_strip_tells_which_of_two_links_is_in_use(tmp_path: Path) -> None:
    async with look(Standin(two()), DESK) as (page, gateway):
        assert await page.value(text_of(1, ".links")) == ""
        radio = {"kind": "serial", "place": "/dev/ttyUSB0", "used": False, "rtt_ms": 310.0, "loss_pct": 2.0, "age_s": 0.3}
        lte = {"kind": "udp", "place": "10.0.0.9:14555", "used": True, "rtt_ms": 48.2, "loss_pct": 0.0, "age_s": 0.1}
        gateway.boat(1)["link"]["all"] = [radio, lte]
        await shown(page, gateway, f"{text_of(1, '.links')} === 'by 10.0.0.9:14555 · /dev/ttyUSB0 stands by, 310 ms'")
        (tmp_path / "links.png").write_bytes(await page.picture())
        lte.update(used=False, age_s=5.2)
        radio.update(used=True)
        await shown(page, gateway, f"{text_of(1, '.links')} === 'by /dev/ttyUSB0 · 10.0.0.9:14555 silent for 5 s'")


async def test_a_boat_that_tells_no_revolutions_has_no_graph_of_them() -> None:
    async with look(Standin(two()), DESK) as (page, gateway):
        graphs = "document.querySelector('[data-boat=\"1\"] .graphs').hidden"
        await shown(page, gateway, f"{graphs} === false")
        gateway.boat(1)["age_s"]["rpm"] = None
        await shown(page, gateway, f"{graphs} === true")


OUTSIDE = """[...document.querySelectorAll('.chip *, .popup *')].filter((each) => {
  const [box, its] = [each.closest('.chip, .popup').getBoundingClientRect(), each.getBoundingClientRect()];
  const cut = each.scrollWidth > each.clientWidth + 1 && getComputedStyle(each).display !== 'inline';
  return its.width && (its.right > box.right || its.left < box.left || (cut && !each.closest('.graph')));
}).map((each) => each.outerHTML)"""


def three() -> list[Message]:
    """Under way, with the longest words that they say."""
    boats = [
        boat(n, name, "#56b4e9", mode="play", armed=True, speed_mps=1.6)
        for n, name in enumerate(("Alfa", "Bravo", "Charlie"), 1)
    ]
    for each in boats:
        each["reference"] = reference(latitude_deg=38.69, longitude_deg=-9.2, distance_m=99_900.0)
        each["mission"] = {"name": "Survey", "count": 800, "current": 799, "state": "differs", "digest": "1"}
        each["link"].update(profile="radio", rtt_ms=12_345.0, loss_pct=35.0)
    boats[2]["reference"] = None
    boats[2]["age_s"] = dict.fromkeys(boats[2]["age_s"], 23.0)
    return boats


@pytest.mark.parametrize(
    "size",
    [
        pytest.param(DESK, id="desk", marks=pytest.mark.long),
        pytest.param(PHONE, id="phone"),
        pytest.param(LANDSCAPE, id="landscape", marks=pytest.mark.long),
    ],
)
async def test_three_boats_are_all_in_sight_and_no_words_run_over_their_boxes(size: tuple[int, int]) -> None:
    async with look(Standin(three()), size) as (page, gateway):
        await page.press("Tab")
        for name in ("Survey", "The-whole-bay-in-lines-of-five-metres"):
            for each in gateway.boats:
                each["mission"]["name"] = name
            await shown(page, gateway, f"{text_of(2, '.mission')} === '{name}: waypoint 800 of 800'")
            assert await page.value(
                "[...document.querySelectorAll('.mission')].map((each) => each.offsetHeight < 20).every(Boolean)"
            )
        outside = [each for each in await page.value(OUTSIDE) if "The-whole-bay" not in each]
        assert outside == []
        edge = 0.42 * size[1] if size is PHONE else size[1]
        for number in (1, 2, 3):
            chip = f"document.querySelector('[data-boat=\"{number}\"]')"
            assert await page.value(f"{chip}.getBoundingClientRect().bottom") <= edge
            for part in ("b", ".mode", ".age", ".bars"):
                assert await page.value(f"{chip}.querySelector('{part}').getClientRects().length") == 1, part
        await page.value("document.querySelector('.selected .fold').click()")
        await page.until("document.querySelector('.selected .fold').textContent === 'Less'")
        for part in (".ages", ".link"):
            assert await page.value(f"document.querySelector('.selected {part}').getClientRects().length") == 1, part


@pytest.mark.parametrize("touch", [False, True])
async def test_a_menu_on_a_touch_screen_shows_no_keys_and_leaves_a_part_of_the_map(touch: bool) -> None:
    async with look(Standin(two()), PHONE if touch else DESK, touch=touch) as (page, _gateway):
        await page.press("Enter")
        await page.until("document.querySelector('.item kbd') !== null")
        assert bool(await page.value("document.querySelector('.item kbd').getClientRects().length")) is not touch
        if touch:
            assert await page.value("document.querySelector('.popup').offsetHeight") < 0.6 * PHONE[1]
        assert await page.value(OUTSIDE) == []


async def test_a_lost_boat_is_forgotten_and_leaves_nothing() -> None:
    async with look(Standin(two()), DESK) as (page, gateway):
        await page.press("Enter")
        await choose(page, "More")
        await page.until("document.querySelector('.popup').textContent.includes('Forget it')")
        await page.value(
            "[...document.querySelectorAll('.item')].find((each) => each.textContent.includes('Forget it')).click()"
        )
        await page.press("Escape")
        await page.press("Escape")
        gateway.boat(1)["age_s"] = dict.fromkeys(gateway.boat(1)["age_s"], 42.0)
        gateway.boat(1)["ghost"] = {"latitude_deg": 38.69, "longitude_deg": -9.215, "radius_m": 400}
        await shown(page, gateway, "document.querySelector('[data-boat=\"1\"]').dataset.age === 'lost'")
        assert [each for each in gateway.said if each["t"] == "forget"] == [], "one that is heard is not"
        await page.press("Enter")
        await choose(page, "More", "Forget it")
        await gateway.until(lambda m: m["t"] == "forget" and m["boat"] == 1)
        del gateway.boats[0]
        await gateway.tell({"t": "forgotten", "boat": 1})
        await shown(page, gateway, "document.querySelectorAll('.chip').length === 1")
        assert await page.value("document.querySelector('.selected').dataset.boat") == "2"
        assert await page.value("delfim.points(1)") == 0


async def test_of_five_hundred_waypoints_those_are_numbered_that_have_room_and_the_round_ones_first() -> None:
    """Near by all in sight have their numbers; from afar first, last and tens that do not lie upon each other."""
    async with look(Standin(two()), DESK) as (page, gateway):
        lines = [(-200.0 + along, 5.0 * row) for row in range(250) for along in ((0, 400) if row % 2 == 0 else (400, 0))]
        mission = {**survey(), "waypoints": waypoints(lines)}
        await gateway.tell({"t": "mission", "boat": 1, "where": "here", "mission": mission})
        await page.until("delfim.drawn().plan === 500")
        for metres, least, most in ((700, 10, 130), (40, 495, 500)):
            await show(page, -metres, -10, metres, 2 * metres)
            if metres == 40:
                await page.value("delfim.fit(38.69018, -9.21502, 38.69022, -9.21498)")
            await page.until(f"delfim.numbers() >= {least} && delfim.numbers() <= {most}")


async def test_on_a_chart_words_stand_on_plates_and_before_a_boat_is_heard_the_chart_is_in_sight() -> None:
    gateway = at_work()
    gateway.boats, gateway.plans, gateway.aboard = [], {}, {}
    async with look(gateway, DESK) as (page, gateway):
        await page.until("document.documentElement.classList.contains('charted')")
        (south, west), (north, east) = place(-300, -620), place(360, 620)
        corners = await page.value(f"[delfim.pixel({south}, {west}), delfim.pixel({north}, {east})]")
        assert all(0 <= x <= 1440 and 0 <= y <= 860 for x, y in corners), corners
        assert abs(corners[0][0] - corners[1][0]) > 500
        (middle_x, middle_y) = [(a + b) / 2 for a, b in zip(*corners, strict=True)]
        assert await page.value(f"document.elementFromPoint({middle_x}, {middle_y}).tagName") == "CANVAS", (
            "nothing covers its middle"
        )
        await page.point(700, 300)
        for part in (".ol-scale-line", "#where"):
            alpha = await page.value(f"getComputedStyle(document.querySelector('{part}')).backgroundColor")
            assert "0.9" in alpha, part
        await page.mouse((middle_x, middle_y))
        await choose(page, "Show the chart")


@pytest.mark.parametrize(
    "size",
    [
        pytest.param(DESK, id="desk", marks=pytest.mark.long),
        pytest.param((1000, 600), id="small", marks=pytest.mark.long),
        pytest.param(PHONE, id="phone"),
    ],
)
async def test_all_of_the_card_of_keys_can_be_scrolled_to(size: tuple[int, int]) -> None:
    async with look(Standin(two()), size) as (page, _gateway):
        await page.press("F1")
        await page.until("document.querySelector('#card:not([hidden]) .line') !== null")
        await page.value("[...document.querySelectorAll('#card .line')].at(-1).scrollIntoView({ block: 'nearest' }), 0")
        right, bottom, most_right, most_bottom = await page.value(
            "((its, box) => [its.right, its.bottom, box.right, box.bottom])"
            "([...document.querySelectorAll('#card .line')].at(-1).getBoundingClientRect(), "
            "document.querySelector('#card').getBoundingClientRect())"
        )
        assert (right <= most_right + 1, bottom <= most_bottom + 1) == (True, True)
        assert await page.value("document.querySelector('#card').scrollWidth <= document.querySelector('#card').clientWidth")


async def test_f6_reaches_the_buttons_that_have_no_key() -> None:
    async with look(Standin(two()), DESK) as (page, _gateway):
        await page.until("!document.getElementById('hint').hidden")
        for _ in range(20):
            await page.press("F6")
            if await page.value("document.activeElement.ariaLabel") == "No more hints":
                break
        await page.press("Enter")
        assert await page.value("document.getElementById('hint').hidden")
        await page.press("Enter")
        await page.until("document.querySelector('.item') !== null")


LAPPED = """(parts => {
  const seen = parts.flatMap((part) => [...document.querySelectorAll(part)].filter((each) => each.getClientRects().length))
    .map((each) => [each.id || each.className, each.getBoundingClientRect(), each]);
  const under = (box) => document.elementFromPoint(box.left + 20, box.bottom - 6)?.closest('.chip');
  const cut = seen.filter(([, box, each]) => each.matches('.chip') && under(box) !== each);
  const lapped = seen.flatMap(([one, a], at) => seen.slice(at + 1).filter(([, b]) =>
    Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1 && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1)
    .map(([other]) => one + ' and ' + other));
  return [...lapped, ...cut.map(([one]) => one + ' is cut')];
})(['#bar', '.chip', '#stop', '#stop-all', '#scale', '#hint', '#traffic', '#base'])"""


@pytest.mark.parametrize(
    "size",
    [*(pytest.param(size, marks=pytest.mark.long) for size in ((390, 844), (844, 390))), (375, 667), (667, 375)],
    ids=str,
)
async def test_nothing_lies_on_anything_on_a_phone_with_three_boats_however_it_is_held(size: tuple[int, int]) -> None:
    async with look(Standin(three()), size, touch=True) as (page, gateway):
        await page.press("Tab")
        await shown(page, gateway, "document.querySelector('.selected [data-boat], .selected') !== null")
        await page.until("!document.getElementById('hint').hidden")
        assert await page.value(LAPPED) == []


async def draw(folder: Path) -> None:
    for name, size in (("upright", (390, 844)), ("lying", (844, 390))):
        async with look(Standin(three()), size, touch=True) as (page, gateway):
            await page.press("Tab")
            await shown(page, gateway, "document.querySelector('.selected') !== null")
            (folder / f"console-three-{name}.png").write_bytes(await page.picture())


def main(folder: Path) -> None:
    """Draw the pictures of the documents."""
    asyncio.run(draw(folder))
    shrink(folder.glob("console-three-*.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

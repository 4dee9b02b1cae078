"""`make pictures`: the console's page in scenes of a day's work, with boats of the stand-in gateway. Needs Chromium."""

import asyncio
import base64
import contextlib
import io
import itertools
import math
import sys
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import TypeAlias

import matplotlib
from matplotlib import pyplot

from tests.console.standin import M_PER_DEG, RPM_MOST, Message, Standin, boat, nearness, place, reference, vessel
from tests.services.browser import Page, browser, shrink

SIZE = (1440, 860)
EAST_M, NORTH_M = (-620.0, 620.0), (-300.0, 360.0)
SPEED_MPS = 1.6
SURVEY = [(-40, -170), (60, -170), (60, -120), (-40, -120), (-40, -70), (60, -70), (60, -20), (-40, -20), (-40, 30), (60, 30)]


def waypoints(corners: list[tuple[float, float]]) -> list[Message]:
    return [
        {"latitude_deg": at[0], "longitude_deg": at[1], "speed_mps": 0, "acceptance_m": 0, "hold_s": 0, "turn": None}
        for at in (place(*corner) for corner in corners)
    ]


def survey() -> Message:
    fence = [list(place(*corner)) for corner in ((-140, -300), (150, -300), (150, 250), (-140, 250))]
    buoy, home = place(-30, 120), place(100, 205)
    return {
        "name": "Survey",
        "waypoints": waypoints(SURVEY),
        "fence": fence,
        "obstacles": [{"latitude_deg": buoy[0], "longitude_deg": buoy[1], "radius_m": 18}],
        "home": {"latitude_deg": home[0], "longitude_deg": home[1]},
    }


def chart() -> bytes:
    """A chart of the river and its bank, as an operator might have drawn it."""
    matplotlib.use("agg")
    figure = pyplot.figure(figsize=(12.4, 6.6), dpi=165)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=EAST_M, ylim=NORTH_M)
    axes.axis("off")
    axes.set_facecolor("#dcebf2")
    axes.add_patch(pyplot.Rectangle((-700, -400), 1400, 800, color="#d3e6ef"))
    east = [EAST_M[0] + i * 8 for i in range(160)]
    for depth, tint in ((-60, "#dfeef3"), (60, "#e9f3f4")):
        shore = [depth + 40 * math.sin(x / 160) + 18 * math.sin(x / 47) for x in east]
        axes.fill_between(east, shore, 400, color=tint)
        axes.plot(east, shore, color="#9fc0cf", linewidth=1)
    bank = [212 + 14 * math.sin(x / 210) + 5 * math.sin(x / 33) for x in east]
    axes.fill_between(east, bank, 400, color="#efe6cf")
    axes.plot(east, bank, color="#8a7d5c", linewidth=1.6)
    axes.add_patch(pyplot.Rectangle((150, 200), 160, 90, facecolor="#e9f3f4", zorder=3))
    for quay in (((150, 221), (150, 290), (310, 290), (310, 211), (215, 200)), ((150, 221), (172, 206))):
        axes.plot(*zip(*quay, strict=True), color="#8a7d5c", linewidth=1.6, zorder=4)
    for x in range(-560, 120, 62):
        axes.add_patch(pyplot.Rectangle((x, 300 + 9 * math.sin(x)), 40, 32, facecolor="#dccfae", edgecolor="#b5a67f"))
    for x, y, words in (
        (-480, -180, "9.2"),
        (-200, -220, "10.1"),
        (120, -190, "8.7"),
        (420, -120, "7.4"),
        (-380, 40, "4.1"),
        (330, 70, "3.3"),
    ):
        axes.text(x, y, words, color="#6d93a6", fontsize=9)
    picture = io.BytesIO()
    figure.savefig(picture, format="png")
    pyplot.close(figure)
    return picture.getvalue()


SIZE_OF_A_BOAT = {"length_m": 4.5, "beam_m": 2.45, "rpm_max": 1200.0}


def two_boats() -> list[Message]:
    delfim = boat(1, "Delfim", "#f4f6f7", north_m=-90, east_m=120, heading_deg=285.0, course_deg=285.0)
    delfim["link"].update(profile="radio", rtt_ms=184.0, loss_pct=1.4)
    delfimx = boat(2, "DelfimX", "#56b4e9", north_m=-40, east_m=-170, heading_deg=0.0, course_deg=0.0)
    delfim["size"] = delfimx["size"] = SIZE_OF_A_BOAT
    return [delfim, delfimx]


class Day:
    """The boats at work: DelfimX on its survey, Delfim by hand around it, at ten frames a second."""

    def __init__(self, gateway: Standin) -> None:
        self.gateway = gateway
        self.along_m = 0.0

    async def sail(self, seconds: float, *, told: bool = True) -> None:
        for _ in range(int(seconds * 10)):
            self._step(0.1)
            if told:
                await self.gateway.frame(0.1)
        await self.gateway.frame(0.1)

    def _step(self, later_s: float) -> None:
        self.along_m += SPEED_MPS * later_s
        left_m, delfimx = self.along_m, self.gateway.boat(2)
        for leg, (a, b) in enumerate(itertools.pairwise(SURVEY)):
            length_m = math.dist(a, b)
            if left_m <= length_m:
                part = left_m / length_m
                heading = math.degrees(math.atan2(b[1] - a[1], b[0] - a[0])) % 360
                weave = 3.0 * math.sin(self.along_m / 9)
                at = place(a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]))
                to = place(*b)
                self._put(delfimx, at, heading + weave, SPEED_MPS, 930 + 60 * math.sin(self.along_m / 5))
                delfimx["reference"] = reference(
                    latitude_deg=to[0],
                    longitude_deg=to[1],
                    leg=leg + 1,
                    distance_m=length_m - left_m,
                    speed_mps=1.7,
                    heading_deg=(heading + 12) % 360,
                )
                delfimx["mission"]["current"] = leg + 1
                break
            left_m -= length_m
        turned = self.along_m / 70
        delfim = self.gateway.boat(1)
        at = place(-90 + 55 * math.sin(turned), 150 + 55 * math.cos(turned))
        self._put(delfim, at, math.degrees(-turned) % 360, 0.9, 610 + 90 * math.sin(self.along_m / 3))

    def _put(self, each: Message, at: tuple[float, float], heading: float, speed: float, rpm: float) -> None:
        each.update(latitude_deg=at[0], longitude_deg=at[1], heading_deg=heading % 360, course_deg=heading % 360)
        each.update(speed_mps=speed, rpm=[rpm, rpm * 1.07], thrust_pct=[100 * rpm / RPM_MOST] * 2)


def at_work() -> Standin:
    """Two boats, a chart, a mission aboard."""
    boats = two_boats()
    name = "river.png"
    south_west, north_east = place(NORTH_M[0], EAST_M[0]), place(NORTH_M[1], EAST_M[1])
    extent = [south_west[1], south_west[0], north_east[1], north_east[0]]
    gateway = Standin(boats, backgrounds=({"name": name, "kind": "image", "extent": extent},))
    gateway.charts[name] = chart()
    gateway.plans[2] = gateway.aboard[2] = survey()
    boats[1].update({key: survey()[key] for key in ("fence", "obstacles", "home")})
    boats[1].update(mode="play", armed=True, speed_pct=60)
    boats[1]["mission"] = {"name": "Survey", "count": len(SURVEY), "current": 1, "state": "same", "digest": "1"}
    boats[0].update(mode="manual", armed=True)
    return gateway


Picture: TypeAlias = Callable[[str], Awaitable[None]]


async def opened(page: Page, gateway: Standin, *, width: int = SIZE[0], height: int = SIZE[1], dark: bool = False) -> None:
    await page.open(gateway.address, width=width, height=height, scale=1.0, dark=dark)
    await page.until("window.delfim !== undefined")
    while not gateway.sockets:
        await asyncio.sleep(0.01)
    await gateway.frame()
    await caught_up(page, gateway)


async def begun(page: Page, gateway: Standin, *, width: int = SIZE[0], height: int = SIZE[1]) -> Day:
    """A day at work on an open page, its hint away, its second boat selected."""
    day = Day(gateway)
    await day.sail(0.1)
    await opened(page, gateway, width=width, height=height)
    await page.value("document.querySelector('#hint button').click()")
    await page.press("Tab")
    return day


async def caught_up(page: Page, gateway: Standin) -> None:
    """Wait until the page has taken the last frame, and with it all that was told before."""
    await page.until(f"delfim.at_s() >= {gateway.at_s}", timeout_s=60.0)


async def show(page: Page, south_m: float, west_m: float, north_m: float, east_m: float) -> None:
    a, b = place(south_m, west_m), place(north_m, east_m)
    await page.value(f"delfim.fit({a[0]}, {a[1]}, {b[0]}, {b[1]})")


@contextlib.asynccontextmanager
async def a_minute_at_work(width: int, height: int) -> AsyncIterator[tuple[Page, Standin]]:
    """A page of a fresh browser, for pictures, and its gateway, whose boats have worked for a minute."""
    gateway = at_work()
    with tempfile.TemporaryDirectory(prefix="pictures-", ignore_cleanup_errors=True) as home:
        async with gateway.serving(), browser(Path(home)) as page:
            day = Day(gateway)
            await day.sail(0.1)
            await opened(page, gateway, width=width, height=height)
            await page.value("document.querySelector('#hint button').click()")
            await show(page, -150, -300, 180, 260)
            await day.sail(60)
            yield page, gateway


async def pixel(page: Page, north_m: float, east_m: float) -> tuple[float, float]:
    """Where on the screen that place beside the Doca is."""
    at = place(north_m, east_m)
    x, y = await page.value(f"delfim.pixel({at[0]}, {at[1]})")
    return x, y


async def work(page: Page, picture: Picture) -> None:
    async with at_work().serving() as gateway:
        day = await begun(page, gateway)
        await show(page, -150, -300, 180, 260)
        await day.sail(230)
        await caught_up(page, gateway)
        await picture("day")
        await page.press("Enter")
        await page.press("ArrowDown")
        await picture("menu")
        await page.press("Escape")
        await page.mouse(await pixel(page, *SURVEY[2]))
        for _ in range(2):
            await page.press("ArrowDown")
        await gateway.frame(0.0)
        await picture("waypoint")
        await page.press("Escape")
        await page.press("F1")
        await gateway.frame(0.0)
        await picture("keys")
        await page.press("F1")
        await silent(page, gateway, day, picture)


async def silent(page: Page, gateway: Standin, day: Day, picture: Picture) -> None:
    """One boat falls silent, the other has a failsafe; the colours of the night."""
    await page.mouse(await pixel(page, -210, 60))
    await choose(page, "Screen", "Colours", "Night")
    delfim = gateway.boat(1)
    at = delfim["latitude_deg"], delfim["longitude_deg"]
    delfim["age_s"] = dict.fromkeys(delfim["age_s"], 23.0)
    delfim["rpm"] = [None, None]
    delfim["ghost"] = {"latitude_deg": at[0] + 12 / M_PER_DEG, "longitude_deg": at[1] - 0.0001, "radius_m": 22}
    gateway.boat(2).update(mode="idle", forced="battery low: 18 %")
    gateway.boat(2)["mission"]["state"] = "differs"
    gateway.boat(2)["battery_pct"] = 18
    began = {"at_s": gateway.at_s - 40}
    stop = began | alert(2, 2, "alarm", "battery low: 18 %: stop", "unacknowledged")
    lost = began | alert(1, 1, "warning", "link lost: nothing is heard from it", "acknowledged", "Ana")
    await gateway.tell({"t": "alerts", "alerts": [stop, lost]})
    await gateway.frame()
    await picture("night")


def alert(number: int, boat: int | None, priority: str, text: str, state: str, by: str = "") -> Message:
    """As the gateway tells it, but for its time."""
    told = {"id": number, "boat": boat, "priority": priority, "text": text, "state": state, "by": by}
    return told | {"sounds": priority == "alarm" and state == "unacknowledged"}


async def choose(page: Page, *titles: str) -> None:
    """Click through the open menu, item by item."""
    for title in titles:
        found = f"[...document.querySelectorAll('.item')].find(i => i.querySelector('.title').firstChild.data === {title!r})"
        await page.until(f"Boolean({found})")
        await page.value(f"{found}.click()")


async def plan(page: Page, picture: Picture) -> None:
    """A plan drawn on the bare graticule: a lawn-mower with its form open."""
    boats = [boat(1, "Delfim", "#f4f6f7", north_m=-60, east_m=-150)]
    async with Standin(boats).serving() as gateway:
        await opened(page, gateway)
        await show(page, -130, -190, 150, 190)
        await gateway.frame()
        await page.mouse(await pixel(page, 20, 0))
        await choose(page, "Pattern", "Lawn-mower…")
        await picture("plan")


async def replayed(page: Page, picture: Picture) -> None:
    gateway = at_work()
    said = (
        (-240, 6, "play: operator"),
        (400, 4, "guest silent for 2.0 s: warn"),
        (900, 2, "battery low: home"),
        (1300, 6, "hold"),
    )
    events = [{"at_s": gateway.at_s + at_s, "boat": 2, "severity": severity, "text": text} for at_s, severity, text in said]
    events.append(
        {"at_s": gateway.at_s + 620, "boat": 2, "severity": 6, "text": "Ana: weed in the port propeller", "note": True}
    )
    gateway.hello["replay"] = {"from_s": gateway.at_s - 300, "to_s": gateway.at_s + 1500, "events": events}
    async with gateway.serving():
        day = await begun(page, gateway)
        times = [gateway.at_s - 300 + 3 * n for n in range(600)]
        values = {
            "speed_mps": [[t, SPEED_MPS - 0.5 * max(0.0, math.cos(t / 31)) ** 30 + 0.03 * math.sin(t)] for t in times],
            "depth_m": [[t, 6.0 + 2.2 * math.sin(t / 160) + 0.6 * math.sin(t / 47)] for t in times],
            "battery_pct": [[t, 91.0 - n / 120] for n, t in enumerate(times)],
        }
        await gateway.tell({"t": "graphs", "boat": 2, "graphs": values})
        await show(page, -150, -300, 180, 260)
        await day.sail(180)
        await caught_up(page, gateway)
        await picture("replay")


async def many(page: Page, picture: Picture) -> None:
    boats = fleet(10)
    async with Standin(boats).serving() as gateway:
        gateway.history = {each["id"]: hour(each) for each in boats}
        await opened(page, gateway)
        for i in range(300):
            for each in boats:
                each["rpm"] = [800 + 150 * math.sin(i / 30 + each["id"]), 830 + 150 * math.sin(i / 31 + each["id"])]
            await gateway.frame()
        await caught_up(page, gateway)
        await picture("fleet")


def fleet(size: int) -> list[Message]:
    colours = ("#f4f6f7", "#56b4e9", "#00835f", "#7a3fb5", "#13233f")
    return [
        boat(
            i + 1,
            f"Boat {i + 1}",
            colours[i % 5],
            north_m=60 * (i % 4) - 90,
            east_m=90 * (i // 4) - 120,
            mode="play",
            speed_mps=1.5,
            speed_pct=50,
            heading_deg=36.0 * i,
            course_deg=36.0 * i,
            rpm=[800.0 + 20 * i, 830.0 + 20 * i],
            armed=True,
        )
        for i in range(size)
    ]


def hour(each: Message) -> list[list[float]]:
    """An hour of track at a point a second, in ever wider rounds that end where the boat is."""
    points = []
    for i in range(3600):
        left = 1 - i / 3600
        angle = math.radians(each["heading_deg"]) + i / 40
        north_m, east_m = 30 * left * math.sin(angle) * (1 + math.sin(i / 400)), 40 * left * math.cos(angle)
        at = each["latitude_deg"] + north_m / M_PER_DEG, each["longitude_deg"] + east_m / (0.78 * M_PER_DEG)
        points.append([1_790_000_000.0 - 3600 + i, *at])
    return points


async def themes(page: Page, picture: Picture) -> None:
    """A tablet in all four."""
    async with at_work().serving() as gateway:
        day = await begun(page, gateway, width=1024, height=768)
        await show(page, -150, -300, 180, 200)
        await day.sail(120)
        for theme in ("Bright", "Day", "Dusk", "Night"):
            await page.value("document.querySelector('#bar .colours').click()")
            await choose(page, theme)
            await gateway.frame()
            await caught_up(page, gateway)
            await picture(f"theme-{theme.lower()}")


async def phone(page: Page, picture: Picture) -> None:
    async with at_work().serving() as gateway:
        day = Day(gateway)
        await day.sail(0.1)
        await opened(page, gateway, width=390, height=780)
        await page.press("Tab")
        await show(page, -130, -190, 110, 40)
        await day.sail(120)
        await caught_up(page, gateway)
        await picture("phone")


def shipping() -> list[Message]:
    """DelfimX gives way to one, one comes near Delfim, one is of unknown size, one lies, and one is lost."""
    return [
        vessel("BRAVO", north_m=-190, east_m=20, course_deg=20.0, heading_deg=22.0, speed_mps=3.1, length_m=24.0)
        | {"domain_m": [109.0, 63.0], "boats": [nearness(1, 12.0, 41.0, "danger"), nearness(2, 210.0, 80.0)]},
        vessel("MARIA", north_m=60, east_m=310, course_deg=262.0, heading_deg=264.0, speed_mps=2.6)
        | {"domain_m": [173.0, 77.0], "boats": [nearness(2, 38.0, 118.0, "near"), nearness(1, 150.0, 60.0)]},
        vessel("244001234", north_m=160, east_m=-240, course_deg=110.0, heading_deg=None, speed_mps=1.9, kind="B", status=15)
        | {"size_known": False, "length_m": 15.0, "boats": [nearness(2, 120.0, 190.0)]},
        vessel("PILAR 7", north_m=-60, east_m=330, course_deg=None, speed_mps=0.0, heading_deg=300.0, status=1)
        | {"boats": [nearness(1, 210.0, -20.0)]},
        vessel("TEJO", north_m=-215, east_m=-170, course_deg=75.0, lost=True, age_s=148.0, margin_m=32.0)
        | {"boats": [nearness(2, 190.0, -50.0)]},
    ]


async def shipping_lane(gateway: Standin, day: Day) -> None:
    """DelfimX gives way; Delfim is in manual, with a ship that comes near."""
    words = "giving way to MARIA, crossing from starboard, passing astern, CPA 93 m"
    gateway.boat(2).update(order={"course_deg": 62.0, "words": words}, guard="on")
    gateway.boat(1).update(guard="off")
    gateway.vessels, gateway.reported_s = shipping(), 3.0
    await gateway.look()
    await day.sail(60)


async def traffic(page: Page, picture: Picture) -> None:
    async with at_work().serving() as gateway:
        day = await begun(page, gateway)
        await show(page, -250, -330, 330, 560)
        await shipping_lane(gateway, day)
        await page.value("document.querySelector('#traffic .said').click()")
        await caught_up(page, gateway)
        await picture("traffic")
        await page.value("document.querySelector('#traffic .main').click()")
        await page.mouse(await pixel(page, 80, 80))
        await choose(page, "Screen", "Guard zone", "100 m")
        await page.mouse(await pixel(page, 80, 80))
        await choose(page, "Screen", "Colours", "Night")
        await gateway.look()
        await caught_up(page, gateway)
        await picture("traffic-night")


async def near(page: Page, picture: Picture) -> None:
    """A quay's length of water: hulls to scale, courses of one time."""
    async with at_work().serving() as gateway:
        await begun(page, gateway)
        at = {"north_m": -52, "east_m": -158, "course_deg": 70.0, "heading_deg": 68.0, "speed_mps": 0.4}
        gateway.vessels, gateway.reported_s = [vessel("LINDA", **at, length_m=11.0, beam_m=3.6)], 3.0
        await gateway.look()
        await gateway.frame()
        await show(page, -60, -185, -25, -140)
        await gateway.frame()
        await caught_up(page, gateway)
        await picture("near")
        await page.value("document.querySelector('#bar .colours').click()")
        await choose(page, "Night")
        await gateway.look()
        await gateway.frame()
        await caught_up(page, gateway)
        await picture("near-night")


async def traffic_on_a_phone(page: Page, picture: Picture) -> None:
    async with at_work().serving() as gateway:
        day = await begun(page, gateway, width=390, height=780)
        await show(page, -330, -170, 130, 80)
        await shipping_lane(gateway, day)
        await caught_up(page, gateway)
        await picture("traffic-phone")


async def main(folder: Path, only: list[str]) -> None:
    for scene in (work, near, traffic, traffic_on_a_phone, plan, replayed, many, themes, phone):
        if only and scene.__name__ not in only:
            continue
        with tempfile.TemporaryDirectory(prefix="page-", ignore_cleanup_errors=True) as place_of_browser:
            async with browser(Path(place_of_browser)) as page:

                async def picture(name: str, page: Page = page) -> None:
                    await page.value("new Promise(done => setTimeout(done, 600))")
                    taken = await page.call("Page.captureScreenshot", format="png")
                    (folder / f"console-{name}.png").write_bytes(base64.b64decode(taken["data"]))

                await scene(page, picture)


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), sys.argv[2:]))
    shrink(Path(sys.argv[1]).glob("console-*.png"))

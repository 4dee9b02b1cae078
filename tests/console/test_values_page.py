"""Values that boats measure: by colour along their tracks, and as graphs."""

import io

from PIL import Image

from tests.console.scenes import choose
from tests.console.standin import Standin, place
from tests.kit.page import sailing, shown, two
from tests.services.browser import Page

WARMTHS = [18.0 + each / 3 for each in range(13)]  # while the boat goes north, a metre and a half each second
BARE = 700.0, 120.0


async def warmed(page: Page, gateway: Standin) -> None:
    for step, warmth in enumerate(WARMTHS):
        latitude_deg, longitude_deg = place(-60.0 + 8.0 * step, -20.0)
        gateway.boat(1).update(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
        gateway.boat(1)["measured"] = {"depth_m": {"value": 4.0, "age_s": 0.1}, "water_c": {"value": warmth, "age_s": 0.1}}
        await gateway.frame(1.0)
    await shown(page, gateway, f"delfim.values().water_c >= {len(WARMTHS)}")


async def track(page: Page) -> tuple[int, ...]:
    """The brightness of the screen along the track: at its beginning, near its end, beyond."""
    await page.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    with Image.open(io.BytesIO(await page.picture())) as screen:
        spots = [place(north_m, -20.0) for north_m in (-56.0, 20.0, 55.0)]
        places = [await page.value(f"delfim.pixel({latitude_deg}, {longitude_deg})") for latitude_deg, longitude_deg in spots]
        scale = screen.width / await page.value("innerWidth")
        return tuple(sum(screen.convert("RGB").getpixel((int(x * scale), int(y * scale)))) for x, y in places)


async def test_a_value_is_drawn_by_colour_along_the_track_and_is_the_first_of_the_graphs() -> None:
    gateway = Standin(two())
    async with sailing(gateway) as page:
        await warmed(page, gateway)
        assert await page.value("document.getElementById('values').hidden")
        sea = (await track(page))[2]
        await page.mouse(BARE)
        await choose(page, "Screen", "Colour of the tracks", "water_c")
        words = "document.getElementById('values').innerText"
        await shown(page, gateway, f"{words}.includes('18.0 °C') && {words}.includes('22.0 °C')")
        cold, warm, beyond = await track(page)
        assert beyond == sea > cold > 450 > 250 > warm, "from light to dark"
        await page.mouse(BARE)
        await choose(page, "Screen", "The last ten minutes")
        await shown(page, gateway, "document.querySelector('#timeline figcaption')?.textContent.includes('water 22.0 °C')")
        await page.mouse((420.0, 120.0))
        await choose(page, "Screen", "Colour of the tracks", "None")
        await shown(page, gateway, "document.getElementById('values').hidden")
        assert (await track(page))[0] > cold, "the boat's colour"
        await page.nothing_amiss()


async def test_a_value_that_is_old_or_came_long_after_the_one_before_colours_nothing() -> None:
    gateway = Standin(two())
    async with sailing(gateway) as page:
        await warmed(page, gateway)
        await page.mouse(BARE)
        await choose(page, "Screen", "Colour of the tracks", "water_c")
        latitude_deg, longitude_deg = place(70.0, -20.0)
        gateway.boat(1).update(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
        gateway.boat(1)["measured"]["water_c"] = {"value": 18.0, "age_s": 9.0}
        count = await page.value("delfim.values().water_c")
        await gateway.frame(20.0)
        gateway.boat(1)["measured"]["water_c"] = {"value": 18.0, "age_s": 0.1}
        await gateway.frame(1.0)
        await shown(page, gateway, f"delfim.values().water_c > {count}")
        assert (await track(page))[2] > 600, "a gap"
        await page.nothing_amiss()

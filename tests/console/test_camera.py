"""What the map keeps to: the boat in sight, its course up. In a real browser at a real gateway; the boat speaks MAVLink."""

import contextlib
import math
from pathlib import Path

import pytest

from tests.console.test_newcomer import Console, console

COURSE_DEG = math.degrees(math.atan2(50, 100))  # of a fake boat, which goes 1.1 m/s
STATE = "[document.querySelector('#north').style.getPropertyValue('--turn'), document.querySelector('#north').ariaLabel]"
FAR = "delfim.fit(38.7, -9.3, 38.701, -9.299)"


@pytest.fixture
def it(tmp_path: Path) -> contextlib.AbstractAsyncContextManager[Console]:
    return console(tmp_path)


def in_sight(place: str) -> str:
    return f"(([x, y]) => x > 300 && x < 1200 && y > 40 && y < 760)(delfim.pixel({place}))"


async def test_the_boat_stays_in_sight_until_a_hand_moves_the_map(it: Console) -> None:
    boat = it.boat(1)
    where = ", ".join(str(each / 1e7) for each in boat.position)
    await it.page.until(in_sight(where))
    await it.page.value(FAR)
    assert not await it.page.value(in_sight(where))
    await it.page.press("f")
    await it.page.until(in_sight(where))
    boat.position[0] += 20_000
    where = ", ".join(str(each / 1e7) for each in boat.position)
    await it.page.value(FAR)
    await it.page.until(in_sight(where))
    await it.page.mouse((700, 300), (730, 320), (760, 340))
    await it.page.value(FAR)
    heard = await it.page.value("delfim.points(1)")
    await it.page.until(f"delfim.points(1) > {heard}")
    assert not await it.page.value(in_sight(where)), "nothing takes the map from the hand"
    x = await it.page.value(f"delfim.pixel({where})[0]")
    await it.page.mouse((700, 300), (730, 320), (760, 340))
    await it.page.until(f"Math.abs(delfim.pixel({where})[0] - {x}) > 20")  # and the hand still moves it


async def test_the_boats_course_is_up_for_who_wants_it(it: Console) -> None:
    boat = it.boat(1)
    latitude, longitude = (each / 1e7 for each in boat.position)
    await it.page.until(in_sight(f"{latitude}, {longitude}"))
    assert await it.page.value(STATE) == ["0deg", "north is up: press for the boat’s course"]
    await it.page.press("n")
    await it.page.until(f"parseFloat({STATE}[0]) < -20")
    turn, words = await it.page.value(STATE)
    assert float(turn.removesuffix("deg")) == pytest.approx(-COURSE_DEG, abs=1.0)
    assert words == "course up: press for north"
    ahead = (
        latitude + 1e-3 * math.cos(math.radians(COURSE_DEG)),
        longitude + 1e-3 * math.sin(math.radians(COURSE_DEG)) / math.cos(math.radians(latitude)),
    )
    (x, y), (i, j) = await it.page.value(f"[delfim.pixel({latitude}, {longitude}), delfim.pixel({ahead[0]}, {ahead[1]})]")
    assert i == pytest.approx(x, abs=3)
    assert j < y - 20, "what is ahead is above"

    await it.page.press("w")
    await it.page.press("ArrowUp")
    await it.page.press("Escape")
    moved, down = await it.page.value(f"delfim.pixel({latitude}, {longitude})")
    assert (moved, down) == (pytest.approx(x, abs=1), pytest.approx(y + 16, abs=1)), "the crosshair goes up the screen"

    await it.page.value("document.getElementById('north').click()")
    assert (await it.page.value(STATE))[0] == "0deg"

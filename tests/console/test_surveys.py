"""Surveys in the gateway: the newest form of a page wins, a bound in time, a computer without Shapely."""

import asyncio
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec

from delfim.base.modes import Mode
from delfim.console.boats.boat import Boat
from delfim.console.gateway.page_messages import Survey
from delfim.console.gateway.surveys import REPLACED, TOO_LONG, Planner, SurveyDesk, request
from delfim.survey.preview import NEEDS
from tests.console.scenes import waypoints
from tests.console.standin import Standin, reference
from tests.console.standin import boat as boat_of_page
from tests.kit.page import sailing, shown

ROOT = Path(__file__).parents[2]
VEHICLE = ROOT / "etc/delfimx.toml"
OUTLINE = [(38.690, -9.215), (38.692, -9.215), (38.692, -9.212), (38.690, -9.212)]


def asked(spacing_m: float, **more: Any) -> Survey:
    return Survey(boat=1, areas=[(OUTLINE, [])], spacing_m=spacing_m, **more)


async def test_of_three_forms_of_a_page_the_first_and_the_newest_are_answered_and_other_pages_too() -> None:
    desk, told, answers = SurveyDesk(VEHICLE), list[dict[str, Any]](), dict[float, tuple[bool, str]]()
    done = asyncio.Event()

    def ask(who: str, spacing_m: float) -> None:
        def answer(well: bool, why: str) -> None:
            answers[spacing_m] = well, why
            if len(answers) == 5:
                done.set()

        desk.ask(who, asked(spacing_m), told.append, answer)

    for who, spacing_m in (("a", 30.0), ("a", 31.0), ("b", 40.0), ("a", 32.0), ("a", 33.0)):
        ask(who, spacing_m)
    async with asyncio.timeout(60):
        await done.wait()
    assert answers == {30.0: (True, ""), 31.0: (False, REPLACED), 32.0: (False, REPLACED), 33.0: (True, ""), 40.0: (True, "")}
    assert [each["spacing_m"] for each in told] == [30.0, 40.0, 33.0]
    assert all(each["mission"]["waypoints"] and each["lines"] for each in told)
    desk.close()


def test_a_survey_that_takes_too_long_ends_with_its_process_and_the_next_one_is_made() -> None:
    planner = Planner(str(VEHICLE))
    assert planner.ask(request(asked(10.0)), limit_s=0.01) == {"refused": TOO_LONG}
    assert planner.ask(request(asked(30.0)))["lines"]
    assert planner.ask(b'{"areas": 3}')["refused"]
    assert planner.ask(request(asked(30.0, speed_mps=900.0)))["refused"].startswith("faster than this boat goes")
    planner.close()


def test_fence_and_obstacles_of_the_plan_are_kept_off() -> None:
    planner = Planner(str(VEHICLE))
    bare = planner.ask(request(asked(20.0)))
    middle = {"latitude_deg": 38.691, "longitude_deg": -9.2135, "radius_m": 20.0}
    around = msgspec.convert(msgspec.to_builtins(asked(20.0, fence=OUTLINE)) | {"obstacles": [middle]}, Survey)
    fenced = planner.ask(request(around))
    planner.close()
    assert bare["covered"][1] > 0.999
    assert fenced["covered"][1] < 0.9
    inside = [place for place in fenced["way"] if not (38.690 < place[0] < 38.692 and -9.215 < place[1] < -9.212)]
    assert inside == []


def test_a_line_is_done_where_the_boat_goes_on_with_its_mission_and_not_where_it_was_stopped_on_it() -> None:
    boat = Boat(1, 0.0)
    boat.enter(Mode.PATH)
    for line in (1, 0, 2, 0, 3):
        boat.take_line(line)
    boat.enter(Mode.HOLD)
    boat.take_line(0)
    assert boat.lines_done == [1, 2]
    boat.enter(Mode.PATH)
    for line in (3, 4):
        boat.take_line(line)
    boat.enter(Mode.HOLD)
    boat.reason = "hold: path done"
    boat.take_line(0)
    assert boat.snapshot(1.0)["lines_done"] == [1, 2, 3, 4]


async def test_lines_that_are_done_are_green_on_the_page_and_the_one_under_way_stands_out() -> None:
    its = boat_of_page(1, "Delfim", "#2e86ab", north_m=90, east_m=0, mode="path", lines_done=[1])
    its["mission"] = {"name": "Bay", "count": 4, "current": 2, "state": "same", "digest": "1"}
    its["reference"] = reference() | {"line": 2}
    gateway = Standin([its])
    stops = waypoints([(0, -20), (100, -20), (100, 20), (0, 20)])
    for line, each in zip((0, 1, 0, 2), stops, strict=True):
        each["line"] = line
    gateway.plans[1] = gateway.aboard[1] = {"name": "Bay", "waypoints": stops, "fence": [], "obstacles": [], "home": None}
    async with sailing(gateway) as page:
        await shown(page, gateway, "delfim.lines().join() === 'done,now'")
        its["reference"]["line"], its["lines_done"] = 0, [1, 2]
        await shown(page, gateway, "delfim.lines().join() === 'done,done'")


def test_without_shapely_the_page_is_told_what_to_install() -> None:
    words = "import sys; sys.modules['shapely'] = None; from delfim.survey.preview import main; main(sys.argv[1])"
    command = [sys.executable, "-c", words, str(VEHICLE)]
    done = subprocess.run(command, input=request(asked(30.0)) + b"\n", capture_output=True, timeout=60, check=True)
    assert json.loads(done.stdout) == {"refused": NEEDS}

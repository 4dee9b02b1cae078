"""Which mission a log's track is drawn over: the one that was sailed last."""

import json
from typing import Any

from delfim.console.tapes.loggedmissions import sailed


def mission(name: str) -> str:
    points = "".join(f"[[waypoint]]\nlatitude_deg = {38.69 + step / 1e4}\nlongitude_deg = -9.21\n" for step in range(2))
    return f'version = 1\nname = "{name}"\n{points}'


def loaded(at_s: int, name: str, refused: str = "") -> dict[str, Any]:
    return {
        "event": "command",
        "t_ns": at_s * 10**9,
        "value": {"command": "mission", "text": mission(name)},
        "refused": refused,
    }


def mode(at_s: int, name: str) -> dict[str, Any]:
    return {"event": "mode", "t_ns": at_s * 10**9, "value": name, "reason": "operator"}


def test_the_mission_that_was_aboard_when_one_was_begun_last() -> None:
    events = [loaded(1, "first"), mode(2, "play"), mode(3, "idle"), loaded(4, "second"), mode(5, "play"), mode(6, "hold")]
    events += [loaded(7, "refused", "no"), loaded(8, "not-sailed")]
    found = sailed(json.loads(json.dumps(events)))
    assert found is not None
    assert found.name == "second"


def test_without_one_that_was_begun_the_one_that_was_sent_last_and_without_any_none() -> None:
    found = sailed([loaded(1, "first"), loaded(2, "second")])
    assert found is not None
    assert found.name == "second"
    assert sailed([mode(1, "play")]) is None

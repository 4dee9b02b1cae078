"""The operator's missions: files of the project's own format (docs/missions.md) in one folder, and as the page has them."""

import os
import re
from pathlib import Path
from typing import Any

import msgspec

from delfim.errors import DelfimError, Refused
from delfim.vehicle.mission import Mission, canonical, load_mission, parse_mission

_NAME = re.compile(r"\w([\w .-]{0,58}[\w-])?")
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)  # to Windows, in every folder


def shown(mission: Mission) -> dict[str, Any]:
    """A mission for the page (docs/console.md). The path that it may have is for the vehicle and is carried along."""
    zones = [each for each in mission.fence.keep_out if each.centre]
    return {
        "name": mission.name,
        "waypoints": [msgspec.to_builtins(each) | {"turn": None} for each in mission.waypoint],
        "path": msgspec.to_builtins(mission.path),
        "fence": [list(corner) for corner in mission.fence.keep_in],
        "obstacles": [
            {"latitude_deg": each.centre[0][0], "longitude_deg": each.centre[0][1], "radius_m": each.radius_m} for each in zones
        ],
        "home": None,
    }


def written(plan: dict[str, Any]) -> Mission:
    """The inverse. Raises Refused with the reason."""
    keys = ("latitude_deg", "longitude_deg", "speed_mps", "acceptance_m", "hold_s")
    circles = [
        {"centre": [[each["latitude_deg"], each["longitude_deg"]]], "radius_m": each["radius_m"]}
        for each in plan.get("obstacles") or []
    ]
    tree = {
        "version": 1,
        "name": plan["name"],
        "waypoint": [{key: each[key] or 0.0 for key in keys if key in each} for each in plan["waypoints"]],
        "path": plan.get("path") or [],
        "fence": {"keep_in": plan.get("fence") or [], "keep_out": circles},
    }
    try:
        return parse_mission(canonical(msgspec.convert(tree, Mission)), str(plan["name"]))
    except (msgspec.ValidationError, DelfimError) as error:
        raise Refused(str(error)) from None


class Library:
    """Missions by name. Names are file names, and nothing else."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def names(self) -> list[str]:
        return sorted(path.stem for path in self._folder.glob("*.toml"))

    def load(self, name: str) -> dict[str, Any]:
        """For the page. Raises Refused with the reason."""
        try:
            return shown(load_mission(self._file(name)))
        except DelfimError as error:
            raise Refused(str(error)) from None

    def save(self, plan: dict[str, Any]) -> None:
        """Whole or not at all. Raises Refused."""
        file, text = self._file(str(plan["name"])), canonical(written(plan))
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            new = file.with_suffix(".new")
            new.write_text(text, encoding="utf-8")
            os.replace(new, file)
        except OSError as error:
            raise Refused(f"{file}: {error.strerror}") from None

    def _file(self, name: str) -> Path:
        if not _NAME.fullmatch(name) or _DEVICE.fullmatch(name):
            raise Refused(f"{name!r:.70} is no name for a mission: up to 60 letters, digits, spaces, dots and dashes")
        return self._folder / f"{name}.toml"

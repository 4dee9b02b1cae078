"""The operator's missions: files of the project's own format (docs/missions.md) in one folder, and as the page has them."""

import os
import re
from pathlib import Path
from typing import Any

from delfim.console.plan import page_of, written
from delfim.errors import DelfimError, Refused
from delfim.vehicle.mission import canonical, load_mission

_NAME = re.compile(r"\w([\w .-]{0,58}[\w-])?")
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)  # to Windows, in every folder


class Library:
    """Missions by name. Names are file names, and nothing else."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def names(self) -> list[str]:
        return sorted(path.stem for path in self._folder.glob("*.toml"))

    def load(self, name: str) -> dict[str, Any]:
        """The mission as the page has it. Raises Refused with the reason."""
        try:
            mission = load_mission(self._file(name))
            return page_of(mission.name, mission.waypoint, mission.path, mission.fence)
        except DelfimError as error:
            raise Refused(str(error)) from None

    def save(self, plan: dict[str, Any]) -> None:
        """Writes it whole or not at all. Raises Refused."""
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
            raise Refused(f"{name!r:.70} is no name for a mission: take up to 60 letters, digits, spaces, dots and dashes")
        return self._folder / f"{name}.toml"

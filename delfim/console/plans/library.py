"""The operator's missions: files of the project's own format (docs/missions.md) in one folder, and as the page has them."""

import re
from pathlib import Path
from threading import Timer
from typing import Any, Final

from delfim.base.cooperative import Sliced
from delfim.base.errors import DelfimError, Refused, in_words
from delfim.base.input.untrusted import read_text
from delfim.base.wholefile import replace_file
from delfim.console.plans.plan import checked_tables, page_of
from delfim.vehicle.plans.mission import canonical, checked
from delfim.vehicle.plans.missionreader import Reading, gathered

READ_S: Final = 30.0

_NAME = re.compile(r"\w([\w .-]{0,58}[\w-])?")
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)  # to Windows, in every folder


class Library:
    """Missions by name. Names are file names, and nothing else. To load and to save takes long: call them in a worker."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def names(self) -> list[str]:
        return sorted(path.stem for path in self._folder.glob("*.toml"))

    def load(self, name: str) -> dict[str, Any]:
        """The mission as the page has it. A process with bounds reads the text: a file may have come from anywhere. Raises
        Refused with the reason."""
        try:
            reading = Reading(read_text(self._file(name)))
            limit = Timer(READ_S, reading.cancel)
            limit.start()
            try:
                lines = reading.lines()
            finally:
                limit.cancel()
                limit.join()  # a thread that is still ending has its stack
            if isinstance(lines, DelfimError):
                raise lines
            mission = Sliced(gathered(lines)).finish()
            Sliced(checked(mission)).finish()
        except (DelfimError, OSError) as error:
            raise Refused(in_words(error)) from None
        return page_of(mission)

    def save(self, plan: dict[str, Any]) -> None:
        """Writes it whole or not at all. Raises Refused."""
        try:
            file, mission = self._file(str(plan["name"])), checked_tables(plan)
            Sliced(checked(mission, str(plan["name"]))).finish()
            text = canonical(mission)
            self._folder.mkdir(parents=True, exist_ok=True)
            replace_file(file, text)
        except (DelfimError, OSError) as error:
            raise Refused(in_words(error)) from None

    def _file(self, name: str) -> Path:
        if not _NAME.fullmatch(name) or _DEVICE.fullmatch(name):
            raise Refused(f"{name!r:.70} is no name for a mission: take up to 60 letters, digits, spaces, dots and dashes")
        return self._folder / f"{name}.toml"

"""What boats tell of themselves, for the pages: the keys of their files that may change under way, the checks before the start.

What was changed can be kept in a file: the vehicle's file of the console with these values, if it is that boat's.
"""

import asyncio
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from aiohttp import web

from delfim import config
from delfim.base import tables
from delfim.base.errors import DelfimError, Refused, in_words
from delfim.console.boats.fleet import Fleet
from delfim.console.gateway import page_messages
from delfim.console.link.mavlink import PARAMS, BoatQuestion, ToldRow
from delfim.console.logs.fetching import LogFetching
from delfim.console.terminal.describe import meaning
from delfim.services.vehiclefile import changed

UNITS: Final = {"per_mps": "per m/s", "dps": "°/s", "dps2": "°/s2", "s": "s", "m": "m", "n": "N", "mps": "m/s", "mps2": "m/s2"}
OF_KEYS: Final = {each.key: each.unit for each in PARAMS}
Tell = Callable[[dict[str, Any]], None]
Answer = Callable[[bool, str], None]


class AboardDesk:
    """`tell` informs all pages. `vehicle`: the console's file of a boat."""

    def __init__(self, fleet: object, vehicle: Path | None, tell: Tell) -> None:
        self._fleet, self._vehicle, self._tell = fleet, vehicle, tell
        self.logs = LogFetching({}, Path("logs"), tell, lambda number: False)
        self._settings = dict[int, dict[str, ToldRow]]()  # by boat and key, as they were told last

    def fetches(self, sources: Mapping[str, str], folder: Path) -> None:
        """Logs of boats by these names come from there, into this folder."""
        if isinstance(self._fleet, Fleet):
            self.logs = LogFetching(sources, folder, self._tell, self._fleet.is_busy)

    def tick(self, now_s: float) -> None:
        if isinstance(self._fleet, Fleet):
            self.logs.tick(self._fleet.boats, now_s)

    def close(self) -> None:
        self.logs.close()

    def ask(self, asked: page_messages.Itself | page_messages.Logs, tell: Tell, answer: Answer) -> None:
        """Raises Refused."""
        if not isinstance(self._fleet, Fleet):
            raise Refused("a recording tells nothing of this")
        boat = self._fleet.boat(asked.boat)
        if isinstance(asked, page_messages.Logs):
            self.logs.ask(boat, asked.do, answer)
        else:
            self._read(self._fleet, asked, tell, answer)

    def _read(self, fleet: Fleet, asked: page_messages.Itself, tell: Tell, answer: Answer) -> None:
        number, of = asked.boat, asked.do

        def read(rows: list[ToldRow], why: str) -> None:
            if not why and of == "settings":
                self._settings[number] = {row.key: row for row in rows}
            if not why:
                tell({"t": "aboard", "boat": number, "of": of, "rows": [_shown(row) for row in rows]})
            answer(not why, why)

        def done(row: ToldRow) -> None:
            if row.key:
                self._settings.setdefault(number, {})[row.key] = row
                self._tell({"t": "aboard", "boat": number, "of": "change", "rows": [_shown(row)]})
            answer(not row.refused, row.refused)

        if of == "change":
            fleet.questions.ask(number, BoatQuestion("change", key=asked.key, value=asked.value), done)
        else:
            fleet.questions.read(number, of, read)

    async def keep(self, asked: web.Request) -> web.Response:
        """A vehicle's file in which the changed keys have the values in force; without one of that boat, these lines alone."""
        rows = self._settings.get(int(asked.query["boat"]) if asked.query.get("boat", "").isdigit() else -1, {})
        try:
            text = await asyncio.to_thread(self._kept, rows, asked.query.get("name", ""))
        except (DelfimError, OSError) as error:
            raise web.HTTPBadRequest(text=f"{in_words(error)}\n") from None
        named = {"Content-Disposition": 'attachment; filename="kept.toml"'}
        return web.Response(text=text, content_type="application/toml", headers=named)

    def _kept(self, rows: dict[str, ToldRow], name: str) -> str:
        values = {key: row.value for key, row in rows.items() if row.value != row.file}
        if self._vehicle is not None and config.load(self._vehicle).boat.name == name:
            return changed(str(self._vehicle), values)
        tree: dict[str, Any] = {}
        for key, value in values.items():
            *path, last = key.split(".")
            table = tree
            for each in path:
                table = table.setdefault(each, {})
            table[last] = value
        return tables.text_of(tree)


def _shown(row: ToldRow) -> dict[str, Any]:
    """As pages have it: with the unit and the meaning of a key."""
    last = row.key.rpartition(".")[2]
    unit = OF_KEYS.get(row.key) or next((unit for end, unit in UNITS.items() if last.endswith(f"_{end}")), "")
    told = {name: getattr(row, name) for name in ("key", "value", "file", "allowed", "words", "refused")}
    return told | {"unit": unit, "meaning": meaning(row.key) if "." in row.key else ""}

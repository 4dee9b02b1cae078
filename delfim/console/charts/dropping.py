"""Official charts that are dropped on the page: read in a process of its own, shown on all pages, kept for the next start, and
sent to a boat as the field that it keeps to.
"""

import asyncio
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from aiohttp import web

from delfim import config
from delfim.base.errors import DelfimError, Refused, in_words
from delfim.base.wholefile import replace_file
from delfim.console.boats.boat import SILENT_S, Boat
from delfim.console.charts.charts import Charts
from delfim.console.logs.fetching import LogFetching
from delfim.vehicle.plans.clearance import BYTES as FIELD_BYTES

BYTES: Final = 50_000_000  # of all that is dropped at once
FILES: Final = 100
LIMIT_S: Final = 300.0  # a cell takes a quarter of a minute
DRAUGHT_M, AIR_M = 2.0, 10.0  # where nobody knows the boat's
KEEL_M: Final = 0.5
NAMED: Final = re.compile(r"[A-Za-z0-9_-]{1,40}\.(\d{3}|031|zip|ZIP)")
PROGRAM: Final = (sys.executable, "-m", "delfim.survey.enc.dropped")
NOBODY_KNOWS: Final = "nobody knows the boat's draught: [boat] draught_m of its file, and --vehicle FILE for the console"
Answer = Callable[[bool, str], None]


class ChartDrop:
    """Answers the pages; `tell` informs all of them. `vehicle`: the boat's file. `logs`: what writes to boats. `changed` is
    called with a field that a boat has got, and answers."""

    def __init__(
        self,
        charts: Charts,
        vehicle: Path | None,
        logs: Callable[[], LogFetching],
        changed: Callable[[Path, Answer], object],
        tell: Callable[[dict[str, Any]], None],
    ) -> None:
        self._charts, self._logs, self._changed, self._tell = charts, logs, changed, tell
        self._settings = config.load(vehicle) if vehicle is not None else None
        self._child: subprocess.Popen[bytes] | None = None
        self._busy = False
        self._unfit = dict[str, str]()  # by the name of a chart: why there is no field of it

    def routes(self, app: web.Application) -> None:
        self._charts.routes(app)
        app.router.add_post("/chart", self.take)

    def close(self) -> None:
        if self._child is not None:
            self._child.kill()

    async def take(self, asked: web.Request) -> web.Response:
        """The files of a chart that a page sends, as a form, with the place (`at`, degrees): what was made of it, in words, or
        why it is `refused`."""
        if self._busy:
            return web.json_response({"refused": "another chart is being read"})
        self._busy = True
        try:
            with tempfile.TemporaryDirectory(prefix="delfim-drop-", ignore_cleanup_errors=True) as place:
                files = await sent_files(asked)
                told = await asyncio.to_thread(self._made, Path(place), files, _places(asked.query.get("at", "")))
        except (DelfimError, OSError) as error:
            told = {"refused": in_words(error)}
        else:
            self._tell({"t": "charts", "backgrounds": self._charts.backgrounds})
        finally:
            self._busy = False
        return web.json_response(told)

    def _made(self, place: Path, files: dict[str, bytes], places: list[tuple[float, float]]) -> dict[str, Any]:
        """In a worker. Raises DelfimError, OSError."""
        for name, data in files.items():
            (place / name).write_bytes(data)
        need, known = self._need()
        job = {"folder": str(place), "need": need, "places": places, "output": str(place / "made")}
        with subprocess.Popen(PROGRAM, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as child:
            self._child = child
            try:
                out = child.communicate(json.dumps(job).encode() + b"\n", LIMIT_S)[0]
            except subprocess.TimeoutExpired:
                child.kill()
                raise Refused(f"not read within {LIMIT_S:.0f} s: drop fewer cells") from None
            finally:
                self._child = None
        try:
            told: dict[str, Any] = json.loads(out)
        except ValueError:
            raise Refused("it takes too much time or memory to read") from None
        if "refused" in told:
            raise Refused(told["refused"])
        name = str(told["name"])
        self._keep(place / "made", name)
        self._unfit[name] = told["unfit"] or ("" if known else NOBODY_KNOWS)
        needs = "; made for a draught of" if known else "; the boat's draught is not known: made for"
        words = f"{told['chart']}: {100.0 * told['no_go']:.0f} % no-go{needs} {need[0]:g} m, and {need[2]:g} m above the water"
        extent = next(each["extent"] for each in self._charts.backgrounds if each["name"] == name)
        return {"name": name, "words": words, "extent": extent}

    def _need(self) -> tuple[tuple[float, float, float], bool]:
        """What the boat needs of the water by its file, as `Need` begins, m; and whether its draught is known."""
        boat = self._settings.boat if self._settings is not None else None
        if boat is None or boat.draught_m <= 0.0:
            return (DRAUGHT_M, KEEL_M, AIR_M), False
        return (boat.draught_m, KEEL_M, boat.air_draught_m or AIR_M), True

    def _keep(self, made: Path, name: str) -> None:
        """Puts the files into the folder of charts, the field first: the next start of the console finds them there."""
        folder = self._charts.path
        if folder is None:
            raise Refused("this console has no folder of charts")
        folder.mkdir(parents=True, exist_ok=True)
        field, shown = made.with_name("made.clearance"), made.with_name("made.geojson")
        if field.exists():
            replace_file(folder / f"{name}.clearance", field.read_bytes())
        else:
            (folder / f"{name}.clearance").unlink(missing_ok=True)
        replace_file(folder / f"{name}.geojson", shown.read_bytes())
        self._charts.again(folder / f"{name}.geojson")

    def unsent(self, boat: Boat, name: str, now_s: float) -> str:
        """Why a chart cannot be sent to a boat as its field; empty: it can."""
        settings, folder = self._settings, self._charts.path
        if now_s - boat.heard_s > SILENT_S:
            return f"{boat.name} is not heard"
        if settings is None or settings.boat.draught_m <= 0.0:
            return NOBODY_KNOWS
        if settings.boat.name != boat.name:
            return f"the console's file is that of {settings.boat.name}: start it with --vehicle FILE of {boat.name}"
        if not settings.fence.chart:
            return "its file names no chart: [fence] chart"
        if Path(settings.fence.chart).parent.name != settings.log.upload_folder:
            return f"its file names {settings.fence.chart}, which is not in its folder {settings.log.upload_folder}"
        if why := self._unfit.get(name, ""):
            return why
        file = folder / f"{name}.clearance" if folder is not None else None
        if file is None or not file.is_file():
            return f"there is no {name}.clearance: drop its cell on the page"
        if (size := file.stat().st_size) > FIELD_BYTES:
            return f"its field is {size / 1e3:.0f} kB: the boat takes {FIELD_BYTES / 1e3:.0f} kB"
        return self._logs().unreached(boat)

    def ask(self, boat: Boat, do: str, name: str, now_s: float, answer: Answer) -> None:
        """Sends a chart (`chart`), and answers when it is there, or says whether it can be sent. Raises Refused with the reason
        why not."""
        if not re.fullmatch(r"[\w-]{1,60}", name):
            raise Refused("no chart has such a name")
        if why := self.unsent(boat, name, now_s):
            raise Refused(why)
        if do == "unsent":
            return answer(True, "")
        assert self._settings is not None
        assert self._charts.path is not None
        field, its = self._charts.path / f"{name}.clearance", Path(self._settings.fence.chart).name

        def arrived(well: bool, why: str) -> None:
            if well:
                self._changed(field, answer)
            else:
                answer(False, why)

        words = f"{boat.name} keeps to {name} from its next start on; plans are checked by it now"
        return self._logs().send(boat, "chart", field, f"{self._settings.log.upload_folder}/{its}", words, arrived)


async def sent_files(asked: web.Request) -> dict[str, bytes]:
    """The files of a form whose names are those of charts; others are passed over. Raises Refused."""
    if not asked.content_type.startswith("multipart/"):
        raise Refused("no files came")
    found, size = dict[str, bytes](), 0
    try:
        async for part in await asked.multipart():
            name, data = Path(getattr(part, "filename", None) or "").name, bytearray()
            while chunk := await part.read_chunk(1 << 16):  # type: ignore[union-attr]
                size += len(chunk)
                if size > BYTES or len(found) >= FILES:
                    raise Refused(f"up to {FILES} files, and {BYTES / 1e6:.0f} MB of them")
                data += chunk
            if NAMED.fullmatch(name):
                found[name if name.lower().endswith("zip") else name.upper()] = bytes(data)
    except (ValueError, AttributeError) as error:
        raise Refused(f"the files did not come whole: {error}") from None
    if not found:
        raise Refused("no cell (.000), update or exchange set (.zip) is among the files")
    return {name.replace(".ZIP", ".zip"): data for name, data in found.items()}


def _places(words: str) -> list[tuple[float, float]]:
    """LAT,LON;LAT,LON: what is wrong in it is left out."""
    found = list[tuple[float, float]]()
    for each in words[:200].split(";"):
        try:
            latitude_deg, longitude_deg = map(float, each.split(","))
        except ValueError:
            continue
        if abs(latitude_deg) <= 85.0 and abs(longitude_deg) <= 180.0:
            found.append((latitude_deg, longitude_deg))
    return found

"""Plans of other programs for the pages: a file that was dropped is read, and a plan is written as one."""

import asyncio
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

import msgspec
from aiohttp import web

from delfim.base.errors import DelfimError, Refused
from delfim.console.gateway import page_messages
from delfim.console.plans.planwriting import written

FILE_BYTES: Final = 1 << 23
READS_MAX: Final = 2  # files at a time
LIMIT_S: Final = 20.0  # of a file; a usual one takes a third of a second
NAME: Final = 80  # letters of a file's name, the last of which count


async def sent_file(asked: web.Request) -> tuple[str, bytes]:
    """The name and the bytes of a file that a page sends. Raises Refused."""
    data = bytearray()
    async for chunk in asked.content.iter_chunked(1 << 16):
        data += chunk
        if len(data) > FILE_BYTES:
            raise Refused(f"more than {FILE_BYTES >> 20} MiB")
    return Path(asked.query.get("name", "")).name[-NAME:], bytes(data)


class PlanFiles:
    """Answers the pages."""

    def __init__(self) -> None:
        self._reads = 0

    def routes(self, app: web.Application) -> None:
        app.router.add_post("/plan", self.read)
        app.router.add_post("/plan/{kind}", self.write)

    async def read(self, asked: web.Request) -> web.Response:
        """The `mission` of a file that a page sends, and what of it is `left` out; or why it is `refused`."""
        if self._reads >= READS_MAX:
            return web.json_response({"refused": "other files are being read"})
        self._reads += 1
        try:
            told = await asyncio.get_running_loop().run_in_executor(None, _read, *await sent_file(asked))
        except Refused as error:
            told = {"refused": str(error)}
        finally:
            self._reads -= 1
        return web.json_response(told)

    async def write(self, asked: web.Request) -> web.Response:
        """The plan that a page sends, as a file to download; 400 with the reason where it is none."""
        try:
            _, data = await sent_file(asked)
            plan = msgspec.json.decode(data, type=page_messages.Plan)
            ending, told = await asyncio.get_running_loop().run_in_executor(
                None, written, f".{asked.match_info['kind']}", json.loads(data)
            )
        except (DelfimError, msgspec.MsgspecError, ValueError) as error:
            return web.Response(status=400, text=str(error))
        name = "".join(each if each.isalnum() else "_" for each in plan.name)[:NAME] or "plan"
        shown = {"Content-Disposition": f'attachment; filename="{name.encode("ascii", "replace").decode()}{ending}"'}
        return web.Response(body=told, content_type="application/octet-stream", headers=shown)


def _read(name: str, data: bytes) -> dict[str, Any]:
    """In a process of its own, with bounds."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        file = Path(folder) / f"plan{Path(name).suffix.lower()[:12]}"
        file.write_bytes(data)
        try:
            command = [sys.executable, "-m", "delfim.console.plans.planfile", str(file)]
            told: dict[str, Any] = json.loads(subprocess.run(command, capture_output=True, timeout=LIMIT_S, check=True).stdout)
        except (OSError, ValueError, subprocess.SubprocessError):
            return {"refused": f"{name}: it was not read within {LIMIT_S:.0f} s: simplify it"}
    if "refused" in told:
        return {"refused": told["refused"].replace(str(file), name)}
    left = told.pop("left")
    return {"mission": told | {"name": Path(name).stem[:60] or "Plan"}, "left": left}

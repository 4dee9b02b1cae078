"""Plans of other programs for the pages: a file that was dropped is read, and a plan is written as one. And a
vehicle's file, by the questions of `delfim new`, or checked."""

import asyncio
import json
from pathlib import Path

import msgspec
from aiohttp import web

from delfim.base.errors import DelfimError
from delfim.console.gateway import page_messages
from delfim.console.plans.planwriting import written
from delfim.console.plans.sent_files import NAME, FileReader, sent_file


class PlanFiles:
    """Answers the pages."""

    def __init__(self) -> None:
        self._reader = FileReader("delfim.console.plans.planfile")
        self._new = FileReader("delfim.commands.description.newform")

    def routes(self, app: web.Application) -> None:
        app.router.add_post("/new", self.new)
        app.router.add_post("/plan", self.read)
        app.router.add_post("/plan/{kind}", self.write)

    async def read(self, asked: web.Request) -> web.Response:
        """The `mission` of a file that a page sends, and what of it is `left` out; or why it is `refused`."""
        name, told = await self._reader.read(asked)
        if "refused" in told:
            return web.json_response(told)
        left = told.pop("left")
        return web.json_response({"mission": told | {"name": Path(name).stem[:60] or "Plan"}, "left": left})

    async def new(self, asked: web.Request) -> web.Response:
        """Of the answers that a page sends (`?name=a.json`) the next `question`, or the `files`; of them, and of a vehicle's
        file that it sends (`?name=a.toml`), what the check says; or why it is `refused`."""
        _, told = await self._new.read(asked)
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

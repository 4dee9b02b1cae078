"""Files that pages send: a process of its own reads each, with bounds, and a thread waits for it."""

import asyncio
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

from aiohttp import web

from delfim.base.errors import Refused

FILE_BYTES: Final = 1 << 23
READS_MAX: Final = 2  # files of a kind at a time
LIMIT_S: Final = 20.0  # of a file; a usual one takes a third of a second
NAME: Final = 80  # letters of a file's name, the last of which count
ENDING: Final = 12  # letters of its ending, which says what it is


async def sent_file(asked: web.Request) -> tuple[str, bytes]:
    """The name and the bytes of a file that a page sends. Raises Refused."""
    data = bytearray()
    async for chunk in asked.content.iter_chunked(1 << 16):
        data += chunk
        if len(data) > FILE_BYTES:
            raise Refused(f"more than {FILE_BYTES >> 20} MiB")
    return Path(asked.query.get("name", "")).name[-NAME:], bytes(data)


class FileReader:
    """Reads files by `python -m MODULE FILE`, which prints what is in one as JSON (`delfim.base.input.bounded.printed`)."""

    def __init__(self, module: str) -> None:
        self._module, self._reads = module, 0

    async def read(self, asked: web.Request) -> tuple[str, dict[str, Any]]:
        """The name of the file that a page sends, and what is in it, or why it is `refused`."""
        if self._reads >= READS_MAX:
            return "", {"refused": "other files are being read"}
        self._reads += 1
        try:
            name, data = await sent_file(asked)
            return name, await asyncio.get_running_loop().run_in_executor(None, self._told, name, data)
        except Refused as error:
            return "", {"refused": str(error)}
        finally:
            self._reads -= 1

    def _told(self, name: str, data: bytes) -> dict[str, Any]:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            file = Path(folder) / f"sent{Path(name).suffix.lower()[:ENDING]}"
            file.write_bytes(data)
            command = [sys.executable, "-m", self._module, str(file)]
            try:
                ended = subprocess.run(command, capture_output=True, timeout=LIMIT_S, check=True)
                told: dict[str, Any] = json.loads(ended.stdout)
            except (OSError, ValueError, subprocess.SubprocessError):
                return {"refused": f"{name}: it was not read within {LIMIT_S:.0f} s: simplify it"}
        if "refused" in told:
            told["refused"] = told["refused"].replace(str(file), name)
        return told

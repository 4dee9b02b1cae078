"""The page in a window of its own, without tabs whose shortcuts would take the operator's keys, where there is such a browser."""

import shutil
import subprocess
import webbrowser
from contextlib import suppress
from typing import Final

CHROMIUM: Final = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "microsoft-edge",
    "msedge",
    "chrome",
)


def show(url: str) -> None:
    """In an application window of Chromium, or in whatever browser the computer prefers. It outlives the console."""
    program = next((found for name in CHROMIUM if (found := shutil.which(name))), None)
    if program is not None:
        with suppress(OSError):
            nothing = subprocess.DEVNULL
            subprocess.Popen([program, f"--app={url}"], stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True)
            return
    webbrowser.open(url)

"""The page in a window of its own, without tabs whose shortcuts would take the keys, where there is a browser for that."""

import os
import shutil
import subprocess
import sys
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
    """In an application window of Chromium, or in whatever browser the computer prefers; nowhere where there is no screen, as
    what would be found there is a browser for terminals. It outlives the console.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return
    program = next((found for name in CHROMIUM if (found := shutil.which(name))), None)
    if program is not None:
        with suppress(OSError):
            nothing = subprocess.DEVNULL
            subprocess.Popen([program, f"--app={url}"], stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True)
            return
    webbrowser.open(url)

"""Opens the page in a window of its own, without tabs whose shortcuts would take the keys, if a browser can do that."""

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
    """Opens an application window of Chromium, or else the computer's preferred browser; none without a screen, where only a
    browser for terminals would be found. It outlives the console.
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

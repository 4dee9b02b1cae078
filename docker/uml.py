"""User-Mode Linux, a kernel that runs as a program, on any processor."""

import re
import subprocess
from pathlib import Path


def has_more_registers() -> bool:
    """Whether this processor has more registers than Debian 12's User-Mode Linux knows of: it needs `preload`, and so cc."""
    return bool(re.search(r"\bamx_tile\b", Path("/proc/cpuinfo").read_text()))


def preload(folder: Path) -> dict[str, str]:
    """What linux.uml must have in its environment beside; a library, if it needs one, comes into the folder (xstate.c)."""
    if not has_more_registers():
        return {}
    library = folder / "xstate.so"
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, Path(__file__).with_name("xstate.c")], check=True)
    return {"LD_PRELOAD": str(library)}

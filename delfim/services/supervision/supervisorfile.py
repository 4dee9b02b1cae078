"""supervisor.json in the run directory: the supervisor's report of its programs, for the others."""

import json
import os
from collections.abc import Sequence
from pathlib import Path

from delfim.base.errors import FormatError
from delfim.base.input.untrusted import parse_json, read_file
from delfim.services.supervision.children import Child


def write_state(path: Path, children: Sequence[Child], deadman: dict[str, object] | None) -> None:
    """Replace the file. Raises OSError."""
    programs = {
        each.program.name: {
            "state": each.state,
            "pid": each.pid,
            "restarts": each.restarts,
            "reason": each.reason,
            "since_s": each.since_s,
        }
        for each in children
    }
    new = path.with_suffix(".new")
    new.write_text(json.dumps({"pid": os.getpid(), "programs": programs, "deadman": deadman}))
    new.replace(path)


def last_deadman(path: Path) -> dict[str, object]:
    """The last event of the dead-man; empty where there was none."""
    try:
        event = parse_json(read_file(path))["deadman"]
    except (OSError, FormatError, KeyError, TypeError):
        return {}
    return event if isinstance(event, dict) else {}

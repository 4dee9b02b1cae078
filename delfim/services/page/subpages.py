"""The pages beside the live one: the checks before the start, and a folder of logs."""

import os
from datetime import UTC, datetime
from html import escape
from urllib.parse import quote

from delfim.logging.ashore.systemlines import LEVELS
from delfim.logging.ashore.tree import readable
from delfim.services.page import document, files, page
from delfim.services.page.api import LogLine, Report
from delfim.services.page.saidlines import LINES_MAX, TEXT_MAX, WantedLines
from delfim.services.page.wording import loglines, size


def checks_page(report: Report) -> str:
    lines = report.vehicle.checks if report.vehicle else ()
    bad = [line for line in lines if not line.ok]
    if not lines:
        mood, title = "bad", "Not known"
    elif bad:
        mood, title = "warn", f"{len(bad)} of {len(lines)} not in order"
    else:
        mood, title = "good", "All in order"
    rows = "".join(
        f'<li class="{kind}"><b>{mark} {escape(line.name)}</b> {escape(line.reason)}</li>'
        for line in lines
        for kind, mark in [("good", "✓") if line.ok else ("bad", "✗")]
    )
    reason = f"<p>{escape(report.reason or page.GONE)}</p>" if report.vehicle is None else ""
    boat = escape(report.vehicle.boat) if report.vehicle else ""
    head = f'<div class="band {mood}"><p>{boat}</p><h1>{title}</h1><p class="why">Before the start</p></div>'
    return document.plain("Before the start", f'{reason}<ul class="lines checks">{rows}</ul>', head)


def system_page(asked: WantedLines, found: list[LogLine]) -> str:
    """The page of the system log: the last lines, newest first, and a form to select them."""
    levels = "".join(f"<option{' selected' if level == asked.level else ''}>{level}</option>" for level in LEVELS)
    form = (
        f'<form class="keys"><label>Level <select name="level">{levels}</select></label>'
        f'<label>Text <input name="text" type="search" maxlength="{TEXT_MAX}" value="{escape(asked.text)}"></label>'
        "<button>Show</button></form>"
    )
    more = f"The last {len(found)}, newest first, times in UTC. " + ("Older ones: " if len(found) < LINES_MAX else "Others: ")
    link = f'<p class="small">{more}<a href="/logs/">Logs</a>, in the folders named system (delfim log cat system).</p>'
    return document.plain("System log", f"{form}{loglines(found)}{link}")


def listing(path: str, found: list[files.Entry], is_all: bool) -> str:
    rows = []
    for each in found:
        slash = "/" if each.is_directory else ""
        at = datetime.fromtimestamp(each.mtime_s, UTC)
        length = "" if each.is_directory else size(each.bytes)
        link = f'<a href="{quote(os.fsencode("./" + each.name), safe="./")}{slash}">{escape(readable(each.name))}{slash}</a>'
        what = escape(files.meaning(path, each))
        rows.append(f'<tr><th>{link}</th><td class="what">{what}</td><td>{length}</td><td>{at:%Y-%m-%d %H:%M:%S}</td></tr>')
    head = '<thead><tr><th>name</th><td class="what">content</td><td>size</td><td>last written, UTC</td></tr></thead>'
    more = "" if is_all else f'<p class="small">The first {files.ENTRIES_MAX}; the rest over FTP or SFTP.</p>'
    table = document.table([head, *rows]) if rows else '<p class="none">empty</p>'
    return document.plain(f"Logs {readable(path)}", f'<p class="trail">{_trail(path)}</p>{table}{more}')


def _trail(path: str) -> str:
    """The way back up, each step a link."""
    steps = [step for step in path.split("/") if step]
    links = [
        f'<a href="{"../" * (len(steps) - n) or "./"}">{escape(readable(step))}</a>' for n, step in enumerate(["Logs", *steps])
    ]
    return " › ".join(links)

"""The frame around sections: one HTML document, its style and script inside, so that a page is one request over the radio."""

import base64
import hashlib
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Final

from delfim.services.page.page import SECTIONS

_HERE: Final = Path(__file__).parent
STYLE: Final = (_HERE / "style.css").read_text(encoding="utf-8")
SCRIPT: Final = (_HERE / "script.js").read_text(encoding="utf-8")
LINKS: Final = (
    ("/", "Boat"),
    ("/checks", "Before the start"),
    ("/system", "System log"),
    ("/logs/", "Logs"),
    ("/api/state", "JSON"),
    ("/metrics", "Metrics"),
)
ICON: Final = (
    "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 16 16'%3E"
    "%3Cpath d='M8 0C11 5 12 10 11 16L8 14L5 16C4 10 5 5 8 0Z' fill='%2307628c'/%3E%3C/svg%3E"
)


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


# Only our own style and script: a script smuggled in by a log's name or a reason is not run.
POLICY: Final = (
    f"default-src 'none'; style-src {_digest(STYLE)}; script-src {_digest(SCRIPT)}; connect-src 'self'; img-src data:; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)


def live(sections: Mapping[str, str], every_s: float, console: str = "") -> str:
    """The live page of the boat. `sections`: HTML by id, "head" among them; `console`: where the operator's console is. Without
    a script it is read again every few seconds."""
    columns = ["", "", ""]
    for each in SECTIONS:
        columns[each.column] += f'<section><h2>{each.title}</h2><div id="{each.id}">{sections[each.id]}</div></section>'
    places = "".join(f"<div>{column}</div>" for column in columns)
    again = f'<noscript><meta http-equiv="refresh" content="{max(round(every_s), 5)}"></noscript>'
    link = f'<a href="{escape(console)}">Console</a>' if console else ""
    body = f'<header><div id="head" role="status">{sections["head"]}</div><div id="late" role="alert"></div></header>'
    return document("Boat", f"{body}<main>{places}</main><footer>{_links()}{link}</footer><script>{SCRIPT}</script>", again)


def plain(title: str, content: str, head: str = "") -> str:
    """A page without updates."""
    top = head or f'<div class="band calm"><p>{escape(title)}</p></div>'
    return document(title, f'<header>{top}</header><nav>{_links()}</nav><main class="page"><section>{content}</section></main>')


def document(title: str, body: str, more: str = "") -> str:
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{escape(title)}</title><link rel="icon" href="{ICON}">{more}<style>{STYLE}</style></head>'
        f"<body>{body}</body></html>"
    )


def table(rows: Iterable[str]) -> str:
    return f'<table class="files">{"".join(rows)}</table>'


def _links() -> str:
    return "".join(f'<a href="{to}">{name}</a>' for to, name in LINKS)

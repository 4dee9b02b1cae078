"""The frame around sections: one HTML document, its style and script inside, so that a page is one request over the radio."""

import base64
import hashlib
import re
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Final

from delfim.services.page.page import SECTIONS

_HERE: Final = Path(__file__).parent
THEMES: Final = ("bright", "day", "dusk", "night")


def _styled(tokens: str, style: str) -> str:
    """The style, with the colours of the console that it uses: without a script day, and night on a dark screen."""
    used = {"color-scheme", *re.findall(r"var\((--\w+)\)", style)}
    themes = ""
    for name, body in re.findall(r"(:root\S*) \{([^}]*)\}", tokens):
        colours = ";".join(each.strip() for each in body.split(";") if each.partition(":")[0].strip() in used)
        themes += f"{name}{{{colours}}}\n"
        if "night" in name:
            themes += f"@media (prefers-color-scheme: dark){{:root:not([data-theme]){{{colours}}}}}\n"
    return themes + style


def _read(name: str) -> str:
    return (_HERE / name).read_text(encoding="utf-8")


STYLE: Final = _styled(_read("tokens.css"), _read("style.css"))
COLOURS: Final = _read("colours.js")
SCRIPT: Final = _read("script.js")
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
    f"default-src 'none'; style-src {_digest(STYLE)}; script-src {_digest(COLOURS)} {_digest(SCRIPT)}; "
    "connect-src 'self'; img-src data:; "
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
        f'<title>{escape(title)}</title><link rel="icon" href="{ICON}">{more}'
        f"<style>{STYLE}</style><script>{COLOURS}</script></head>"
        f"<body>{body}</body></html>"
    )


def table(rows: Iterable[str]) -> str:
    return f'<table class="files">{"".join(rows)}</table>'


def _links() -> str:
    links = "".join(f'<a href="{to}">{name}</a>' for to, name in LINKS)
    themes = "".join(f'<option value="{each}">{each.capitalize()}</option>' for each in THEMES)
    return f'{links}<select id="colours" aria-label="Colours">{themes}</select>'

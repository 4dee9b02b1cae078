"""A page of results for people: tables and pictures in one HTML file, which needs neither network nor server."""

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE: Final = """
body { font: 16px/1.45 system-ui, sans-serif; max-width: 1080px; margin: 2rem auto; padding: 0 1rem; color: #0d2230 }
h1 { margin-bottom: .2rem }
table { border-collapse: collapse; margin: .6rem 0 }
td, th { padding: .2rem .8rem .2rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid #dde5ea }
td.n { text-align: right; font-variant-numeric: tabular-nums }
img { max-width: 100%; margin: .4rem 0 }
.holds { color: #0f7a4d; font-weight: 600 }
.fails { color: #b4232f; font-weight: 600 }
code { background: #eef3f6; padding: .1rem .3rem; font-size: .85em }
p.soft { color: #4d6472 }"""


def whole(title: str, body: Iterable[str]) -> str:
    """The text of a page."""
    head = "<!doctype html><html lang=en><meta charset=utf-8><link rel=icon href='data:,'>"  # else a browser asks for one
    head += f"<title>{escape(title)}</title><style>{STYLE}</style>"
    return head + "".join(body) + "\n"


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table; numbers stand to the right, and a command of ours as what is typed."""

    def cell(value: object) -> str:
        if isinstance(value, str):
            words = escape(value)
            return f"<td><code>{words}</code></td>" if value.startswith("delfim ") else f"<td>{words}</td>"
        return f"<td class=n>{shown(value)}</td>"

    body = "".join(f"<tr>{''.join(map(cell, row))}</tr>" for row in rows)
    return f"<table><tr>{''.join(f'<th>{escape(each)}</th>' for each in head)}</tr>{body}</table>"


def shown(value: object) -> str:
    """A value in a few digits; nothing for None."""
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)


def picture(figure: "Figure", words: str) -> str:
    """A picture within the page; the words are for who does not see it."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return f'<img alt="{words}" src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}">'

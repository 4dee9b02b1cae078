"""The token that opens the page, and the console's number, which is derived from it: boats tell consoles apart by it."""

import hashlib
import hmac
import os
import re
import secrets
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path
from typing import Any, Final

from aiohttp import web

from delfim.base.errors import FormatError
from delfim.base.input.untrusted import read_text
from delfim.console.pages.installable import PUBLIC
from delfim.console.watch.operators import ConsoleOperator, OperatorsFile

TOKEN_BYTES: Final = 12
COOKIE_S: Final = 90 * 86_400  # an app on a tablet asks once, and not at each start
NUMBERS: Final = range(200, 255)  # of consoles; QGroundControl and MAVProxy have 255
_TOKEN: Final = re.compile(r"[\w-]{16}", re.ASCII)
CLOSED: Final = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1"><title>Delfim</title>
<style>
:root { color-scheme: light dark; }
body { font: 17px/1.5 system-ui, sans-serif; max-width: 34em; margin: 18vh auto; padding: 0 1.2em; }
code { font-size: 15px; }
form { display: flex; gap: .6em; }
input, button { font: inherit; padding: .5em .8em; min-width: 0; }
input { flex: 1; }
</style>
<h1>This console is locked</h1>
<p>The address needs the console's token, and this one has none or another one.</p>
<form><input name="token" aria-label="token or key" placeholder="token or key" autocomplete="off" autocapitalize="off" required>
<button>Open</button></form>
<p>It is in the address that <code>delfim console</code> printed when it started, which ends with <code>?token=…</code>.
On the console's computer it is also in the file <code>~/.local/state/delfim/console.token</code>, unless
<code>--token</code> names another; on a boat that serves this page in the file <code>token</code> of
<code>tablet.directory</code>. Where operators have keys of their own, it is the key of one.</p>
</html>
"""
OPERATOR: Final = web.RequestKey("operator", ConsoleOperator)
LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")


class Admission:
    """Checks every request. Draws a token if none is given; it opens nothing where operators have keys of their own."""

    def __init__(self, token: str = "", operators: OperatorsFile | None = None) -> None:
        self.token = token or secrets.token_urlsafe(TOKEN_BYTES)
        self.operators = operators or OperatorsFile(None)

    @web.middleware
    async def admit(self, request: web.Request, handler: Callable[[web.Request], Any]) -> web.StreamResponse:
        """Admits requests with the token, which is in the address that the console prints, and then in a cookie. A page of
        another site may not act for its visitor. On loopback only this computer's own names count: the owner of any other name
        could point it here."""
        host, (own, port) = request.headers.get("Host", ""), _end(request)
        if own.is_loopback and host.lower() not in {f"{name}:{port}" for name in (bracketed(own), *LOOPBACK)}:
            raise web.HTTPForbidden(text=f"this console is at {request.scheme}://{bracketed(own)}:{port}/\n")
        site = f"{request.scheme}://{host}"
        if request.headers.get("Origin", site) != site or not host:
            raise web.HTTPForbidden(text="pages of another site may not use this console\n")
        if request.path in PUBLIC:
            public: web.StreamResponse = await handler(request)
            return public
        cookie = f"delfim-{port}"  # a browser keeps cookies by host, and several consoles may be on one
        given = request.query.get("token") or request.cookies.get(cookie) or ""
        operator = self.operators.of(given) if self.operators.closed else None
        known = operator is not None if self.operators.closed else hmac.compare_digest(given.encode(), self.token.encode())
        if not known:
            if "text/html" in request.headers.get("Accept", ""):  # a person with a browser
                raise web.HTTPForbidden(text=CLOSED, content_type="text/html")
            raise web.HTTPForbidden(text="open the address that the console printed when it started: ...?token=...\n")
        if operator is not None:
            request[OPERATOR] = operator
        response: web.StreamResponse = await handler(request)
        if "token" in request.query and not response.prepared:
            # Lax: the boat's page has a link to here
            response.set_cookie(cookie, given, max_age=COOKIE_S, secure=request.secure, httponly=True, samesite="Lax")
        return response


def _end(request: web.Request) -> tuple[IPv4Address | IPv6Address, int]:
    """Our end of the connection."""
    if request.transport is None:
        raise web.HTTPForbidden(text="the connection is gone\n")
    host, port = request.transport.get_extra_info("sockname")[:2]
    return ip_address(host.partition("%")[0]), port


def bracketed(address: IPv4Address | IPv6Address) -> str:
    return f"[{address}]" if address.version == 6 else str(address)


def own_number(token: str) -> int:
    """The number of this console, derived from its token: boats tell consoles apart by it."""
    return NUMBERS[hashlib.sha256(token.encode()).digest()[0] % len(NUMBERS)]


def kept_token(file: Path) -> str:
    """The token, the same at each start, so that an open page finds its console again. If no file can be written, it holds for
    this run only."""
    with suppress(OSError, FormatError):
        if _TOKEN.fullmatch(token := read_text(file).strip()):
            return token
    token = secrets.token_urlsafe(TOKEN_BYTES)
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        with open(file, "w", encoding="ascii", opener=partial(os.open, mode=0o600)) as out:
            out.write(f"{token}\n")
    return token

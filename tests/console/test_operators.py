"""Operators with names, roles and keys at the real gateway: who may what, who commands, and how the command changes hands."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from delfim.base.errors import ConfigError
from delfim.console.watch.operators import OperatorsFile, Role, add_operator, read_operators, revoke_operator
from tests.console.test_gateway import opened

Message = dict[str, Any]


class Someone:
    """A page of an operator, which proves what it hears while it is not deaf."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket, self.word, self.answers = socket, Message(), dict[int, Message]()
        self.is_deaf, self._seq = False, 0

    async def listen(self) -> None:
        async for frame in self._socket:
            told = frame.json()
            if told["t"] == "bridge" and not self.is_deaf:
                self.word = told
                grant = told["grant"] if told["granted"] == told["you"] else 0
                await self._socket.send_json({"t": "here", "n": told["n"], "grant": grant})
            elif told["t"] == "answer":
                self.answers[told["seq"]] = told

    async def ask(self, **words: Any) -> str:
        """The reason of a refusal, or nothing."""
        self._seq += 1
        await self._socket.send_json({"seq": self._seq, **words})
        async with asyncio.timeout(200):
            while self._seq not in self.answers:
                await asyncio.sleep(0.01)
        reason: str = self.answers[self._seq]["reason"]
        return reason

    async def until(self, **wanted: Any) -> None:
        async with asyncio.timeout(200):
            while not self.word or any(self.word[key] != value for key, value in wanted.items()):
                await asyncio.sleep(0.01)

    @property
    def page(self) -> int:
        number: int = self.word["you"]
        return number


@contextlib.asynccontextmanager
async def manned(tmp_path: Path, **roles: str) -> AsyncIterator[tuple[Any, dict[str, Someone], Path]]:
    """The gateway with two boats, and a page of each of these operators."""
    file = tmp_path / "operators.json"
    keys = {name: add_operator(file, name, role) for name, role in roles.items()}
    someone = dict[str, Someone]()
    async with contextlib.AsyncExitStack() as stack:
        sea = await stack.enter_async_context(opened(tmp_path, operators=OperatorsFile(file), key=next(iter(keys.values()))))
        group = await stack.enter_async_context(asyncio.TaskGroup())
        for name, key in keys.items():
            session = await stack.enter_async_context(aiohttp.ClientSession())
            socket = await stack.enter_async_context(session.ws_connect(f"{sea.url}ws?token={key}"))
            someone[name] = Someone(socket)
            stack.callback(group.create_task(someone[name].listen()).cancel)
            await someone[name].until()
        yield sea, someone, file


async def test_orders_are_obeyed_of_who_commands_alone_and_stop_of_everybody(tmp_path: Path) -> None:
    async with manned(tmp_path, Ana="command", Rui="command", Zita="watch") as (sea, on, _):
        ana, rui, zita = on["Ana"], on["Rui"], on["Zita"]
        hold: Message = {"t": "command", "boat": 2, "command": "mode", "mode": "hold"}
        stop = hold | {"command": "stop"}
        del stop["mode"]
        assert "nobody commands" in await ana.ask(**hold)
        assert "role watch" in await zita.ask(t="handover", do="take")
        await ana.ask(t="handover", do="take")
        await rui.until(holder=ana.page)
        assert await ana.ask(**hold) == ""
        assert await rui.ask(**hold) == "Ana commands"
        assert "role watch" in await zita.ask(**hold)
        assert "somebody commands" in await rui.ask(t="handover", do="take")
        assert await zita.ask(**stop) == ""
        assert "needs maintain" in await ana.ask(t="depths", do="forget")
        assert await ana.ask(t="handover", do="offer", page=rui.page) == ""
        assert "not offered" in await ana.ask(t="handover", do="accept")
        await rui.until(offered=rui.page)
        assert await rui.ask(t="handover", do="accept") == ""
        await ana.until(holder=rui.page)
        assert await ana.ask(**hold) == "Rui commands"
        assert await rui.ask(**hold) == ""
        said = [(line.who, line.what, line.text) for line in sea.gateway.watch.log.lines]
        for line in (
            ("Ana", "command", "commands"),
            ("Ana", "command", "offers the command to Rui"),
            ("Rui", "command", "commands"),
            ("Rui", "refused", "hold: Ana commands"),
        ):
            assert line in said


async def test_a_deaf_page_loses_the_command_and_is_offered_none(tmp_path: Path) -> None:
    async with manned(tmp_path, Ana="command", Rui="command") as (_, on, _file):
        ana, rui = on["Ana"], on["Rui"]
        await ana.ask(t="handover", do="take")
        await rui.until(holder=ana.page)
        assert await ana.ask(t="handover", do="offer", page=rui.page) == ""
        await rui.until(offered=rui.page)
        rui.is_deaf = True
        async with asyncio.timeout(200):
            while next(each["carries"] for each in ana.word["pages"] if each["name"] == "Rui"):
                await asyncio.sleep(0.01)
        assert "cannot carry a stop" in await rui.ask(t="handover", do="accept")
        rui.is_deaf, ana.is_deaf = False, True
        await rui.until(holder=0)
        assert "nobody commands" in await ana.ask(t="command", boat=1, command="mode", mode="hold")


async def test_a_revoked_key_closes_its_page_and_no_other(tmp_path: Path) -> None:
    async with manned(tmp_path, Ana="command", Rui="maintain") as (sea, on, file):
        await on["Ana"].ask(t="handover", do="take")
        await on["Rui"].until(holder=on["Ana"].page)
        revoke_operator(file, "Ana")
        await on["Rui"].until(holder=0)
        async with asyncio.timeout(200):
            while [each["name"] for each in on["Rui"].word["pages"]] != ["Rui"]:
                await asyncio.sleep(0.01)
        async with aiohttp.ClientSession() as session, session.get(sea.url, params={"token": sea.gateway.token}) as answer:
            assert answer.status == 403, "the token of the console opens nothing"
        await on["Rui"].ask(t="handover", do="take")
        await on["Rui"].until(holder=on["Rui"].page)


def test_a_file_of_operators_has_no_keys_and_is_changed_by_names(tmp_path: Path) -> None:
    file = tmp_path / "state" / "operators.json"
    assert not OperatorsFile(file).closed
    key = add_operator(file, "Ana Maria", "maintain")
    add_operator(file, "Rui", "watch")
    assert key not in file.read_text()
    found = OperatorsFile(file)
    ana = found.of(key)
    assert ana is not None
    assert (ana.name, ana.rank, found.of("x"), found.closed) == ("Ana Maria", Role.MAINTAIN, None, True)
    for name, role, why in (("Rui", "command", "already"), ("", "watch", "not a name"), ("Eva", "king", "not a name")):
        with pytest.raises(ConfigError, match=why):
            add_operator(file, name, role)
    with pytest.raises(ConfigError, match="nobody of that name"):
        revoke_operator(file, "Eva")
    revoke_operator(file, "Ana Maria")
    assert [each.name for each in read_operators(file)] == ["Rui"]
    assert found.changed()
    assert found.of(key) is None
    file.write_text("[{}]")
    assert found.changed()
    assert (found.known, "no file of operators" in found.reason) == ((), True)
    with pytest.raises(ConfigError):
        OperatorsFile(file)

"""Who is woken, by what and how often: RFC 8291's own example, a played push service that decrypts as a browser does, and the
addresses that are asked nothing."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from pathlib import Path
from socket import AF_INET
from typing import Any

import msgspec
import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature
from cryptography.hazmat.primitives.hashes import SHA256
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.clock import ManualClock
from delfim.base.errors import FormatError
from delfim.console.pages import webpush
from delfim.console.pages.pushing import BROWSERS_MAX, WAITING_MAX, KeptPush, PublicNames, PushDesk
from delfim.console.pages.webpush import PushKeys, PushSubscription
from delfim.console.watch.alerts import AlertList
from delfim.console.watch.operators import OperatorsFile
from tests.certificates import certificate
from tests.console.pushservice import Browser, PlayedService

__all__ = ["certificate"]
ALARM, WARNING = 2, 4  # MAVLink's severities

# RFC 8291, appendix A
SAID = b"When I grow up, I want to be a watermelon"
UA_PUBLIC = "BCVxsr7N_eNgVRqvHtD0zTZsEc6-VV-JvLexhqUzORcxaOzi6-AYWXvTBHm4bjyPjs7Vd8pZGH6SRpkNtoIAiw4"
AUTH, SALT = "BTBZMqHH6r4Tts7J_aSIgg", "DGv6ra1nlYgDCS1FRnbzlw"
AS_PRIVATE = "yfWPiYE-n46HLnH0KqZOF1fJJU3MYrct3AELtAQ-oRw"
BODY = (
    "DGv6ra1nlYgDCS1FRnbzlwAAEABBBP4z9KsN6nGRTbVYI_c7VJSPQTBtkgcy27mlmlMoZIIgDll6e3vCYLocInmYWAmS6TlzAC8wEqKK6PBru3jl7A_yl95b"
    "Qpu6cVPTpK4Mqgkf1CXztLVBSt2Ks3oZwbuwXPXLWyouBWLVWGNWQexSgSxsj_Qulcy4a-fN"
)


def test_the_example_of_rfc_8291() -> None:
    own, salt = webpush.private_key(AS_PRIVATE), webpush.decoded(SALT)
    assert webpush.coded(webpush.encrypted(SAID, PushKeys(UA_PUBLIC, AUTH), own, salt)) == BODY
    assert webpush.number_of(own) == AS_PRIVATE


@given(st.binary(max_size=webpush.PLAIN_MAX))
def test_the_browser_reads_what_was_sent_and_each_message_is_ciphered_anew(message: bytes) -> None:
    its = Browser()
    one, two = webpush.encrypted(message, its.keys), webpush.encrypted(message, its.keys)
    assert (its.reads(one), its.reads(two)) == (message, message)
    assert one[:86] != two[:86]
    assert len(one) <= 4096


@given(st.text(max_size=100), st.text(max_size=100), st.text(max_size=200))
def test_whatever_a_page_gives_is_checked(p256dh: str, auth: str, endpoint: str) -> None:
    with contextlib.suppress(FormatError):
        PushSubscription(endpoint, PushKeys(p256dh, auth)).check()


@pytest.mark.parametrize(
    "endpoint",
    [
        "http://push.example.org/a",
        "https://push.example.org:8443/a",
        "https://127.0.0.1/a",
        "https://192.168.1.1/a",
        "https://[::1]/a",
        "https://localhost/a",
        "https://boat/a",
        "https://push..example.org/a",
        f"https://{'a' * 64}.example.org/a",
        "https://pus\u0301h.example.org/a",
        "https://push.exam ple.org/a",
        "https://ana:secret@push.example.org/a",
        "https://push.example.org:x/a",
        "file:///etc/passwd",
        "",
    ],
)
def test_only_https_at_a_public_name_is_asked(endpoint: str) -> None:
    with pytest.raises(FormatError, match="endpoint"):
        PushSubscription(endpoint, Browser().keys).check()


async def test_a_name_that_points_into_a_private_network_is_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    names = PublicNames()
    for address, is_public in (("192.168.1.1", False), ("127.0.0.1", False), ("169.254.1.1", False), ("1.1.1.1", True)):

        async def told(*_: Any, here: str = address) -> list[dict[str, Any]]:
            return [{"host": here}, {"host": "8.8.8.8"}]

        monkeypatch.setattr(names._names, "resolve", told)
        if is_public:
            assert len(await names.resolve("push.example.org", 443, AF_INET)) == 2
        else:
            with pytest.raises(OSError, match="is no public place"):
                await names.resolve("push.example.org", 443, AF_INET)
    await names.close()


class Watch:
    """A desk, the alerts that it looks at, and the service."""

    def __init__(self, desk: PushDesk, service: PlayedService) -> None:
        self.desk, self.service = desk, service
        self.alerts = AlertList(lambda: 1_795_000_000.0)
        self._follow = asyncio.create_task(desk.follow())

    def look(self) -> None:
        self.desk.look(self.alerts.standing, lambda number: "Alfa" if number == 1 else "")

    async def heard(self, count: int) -> list[tuple[str, dict[str, str], bytes]]:
        async with asyncio.timeout(60.0):
            while len(self.service.heard) < count or not self.desk.is_idle:
                await asyncio.sleep(0.01)
        return self.service.heard

    async def end(self) -> None:
        self._follow.cancel()
        await asyncio.gather(self._follow, return_exceptions=True)


@contextlib.asynccontextmanager
async def watching(folder: Path, pem: Path, *browsers: PushSubscription) -> AsyncIterator[Watch]:
    service = PlayedService()
    async with service.serving(pem) as trust:
        clock = ManualClock(time_ns=1_795_000_000_000_000_000)
        (folder / "push.json").write_bytes(msgspec.json.encode(KeptPush(AS_PRIVATE, [*browsers])))
        desk = PushDesk(folder / "push.json", OperatorsFile(None), clock, "mailto:ana@example.org", service, trust, (0.0, 0.0))
        watch = Watch(desk, service)
        try:
            yield watch
        finally:
            await watch.end()


async def test_a_grave_alert_wakes_each_browser_once(tmp_path: Path, certificate: Path) -> None:
    its = Browser()
    async with watching(tmp_path, certificate, its.at("one"), its.at("two")) as watch:
        watch.alerts.hear(1, ALARM, "stood when the console started: stop")
        watch.look()
        watch.alerts.hear(1, WARNING, "link weak: 12 % lost")
        watch.alerts.hear(1, ALARM, "port propeller blocked: stop")
        for _ in range(3):
            watch.look()
        heard = await watch.heard(2)
        watch.alerts.hear(1, ALARM, "port propeller blocked: stop")
        watch.look()
        assert sorted(path for path, _, _ in heard) == ["/one", "/two"]
        for _, headers, body in heard:
            words = json.loads(its.reads(body))
            assert (words["title"], words["body"]) == ("Alfa: alarm", "port propeller blocked: stop")
            assert (headers["Content-Encoding"], headers["Urgency"], headers["TTL"]) == ("aes128gcm", "high", "3600")
        assert verified(heard[0][1]["Authorization"])["sub"] == "mailto:ana@example.org"
        assert await watch.heard(2) == heard
        assert watch.desk.reason == ""


def verified(header: str) -> dict[str, Any]:
    """The claims of a VAPID header whose signature is of the key that it names."""
    token, point = header.removeprefix("vapid t=").split(", k=")
    words, _, signature = token.rpartition(".")
    r, s = (int.from_bytes(webpush.decoded(signature)[at : at + 32]) for at in (0, 32))
    webpush.public_key(point).verify(encode_dss_signature(r, s), words.encode(), ec.ECDSA(SHA256()))
    claims: dict[str, Any] = json.loads(webpush.decoded(words.partition(".")[2]))
    assert claims["aud"] == "https://push.example.org"
    assert 0 < claims["exp"] - 1_795_000_000 <= 86_400
    return claims


@pytest.mark.parametrize(
    ("statuses", "count", "left", "reason"),
    [
        ([410], 1, 0, ""),
        ([404], 1, 0, ""),
        ([500, 201], 2, 1, ""),
        ([429], 3, 1, "nobody is woken by push: its service answered 429"),
        ([403], 1, 1, "nobody is woken by push: its service answered 403"),
        ([302], 1, 1, "nobody is woken by push: its service answered 302"),
    ],
)
async def test_what_a_service_answers(
    tmp_path: Path, certificate: Path, statuses: list[int], count: int, left: int, reason: str
) -> None:
    async with watching(tmp_path, certificate, Browser().at("one")) as watch:
        watch.service.statuses = statuses
        watch.look()
        watch.alerts.hear(1, ALARM, "port propeller blocked: stop")
        watch.look()
        assert len(await watch.heard(count)) == count
        assert watch.desk.reason == reason
        assert len(json.loads((tmp_path / "push.json").read_text())["browsers"]) == left


async def test_a_service_that_is_not_there_is_told_and_holds_nobody(tmp_path: Path, certificate: Path) -> None:
    async with watching(tmp_path, certificate, Browser().at("one")) as watch:
        watch.service._port = 1
        watch.look()
        for number in range(2 * WAITING_MAX):
            watch.alerts.hear(number, ALARM, "port propeller blocked: stop")
        watch.look()
        async with asyncio.timeout(60.0):
            while not watch.desk.reason:
                await asyncio.sleep(0.01)
        assert "nobody is woken by push" in watch.desk.reason


def test_a_file_that_is_wrong_says_so_and_wakes_nobody(tmp_path: Path) -> None:
    for words in ("{", '{"browsers": 3}', '{"browsers": [{"endpoint": "http://a", "keys": {"p256dh": "", "auth": ""}}]}'):
        (tmp_path / "push.json").write_text(words)
        desk = PushDesk(tmp_path / "push.json", OperatorsFile(None), ManualClock())
        assert "who is to be woken is lost" in desk.reason
    assert BROWSERS_MAX == 16


async def test_a_place_that_cannot_be_asked_is_told_and_the_others_are_woken(tmp_path: Path, certificate: Path) -> None:
    wrong = PushSubscription("https://wrong.example.org/a", Browser().keys)
    async with watching(tmp_path, certificate, wrong, Browser().at("one")) as watch:
        found = watch.service.resolve

        async def resolve(name: str, *rest: Any, **more: Any) -> Any:
            if name.startswith("wrong"):
                raise UnicodeError("label empty or too long")
            return await found(name, *rest, **more)

        watch.service.resolve = resolve  # type: ignore[method-assign]
        watch.look()
        watch.alerts.hear(1, ALARM, "port propeller blocked: stop")
        watch.look()
        assert len(await watch.heard(1)) == 1
        assert "label empty or too long" in watch.desk.reason

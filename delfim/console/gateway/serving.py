"""`delfim console`: runs the gateway with its sockets."""

import argparse
import asyncio
import errno
import logging
import signal
import ssl
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from importlib.util import find_spec
from ipaddress import ip_address
from pathlib import Path
from typing import Final

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from delfim.base.clock import WakefulClock
from delfim.base.errors import ConfigError
from delfim.base.eventloop import new_event_loop
from delfim.console.gateway.browser import show
from delfim.console.gateway.foxglove import FoxgloveView
from delfim.console.gateway.gateway import Gateway
from delfim.console.link.mavlink import Key
from delfim.console.logs.fetching import sources_of
from delfim.console.pages.admission import bracketed, kept_token
from delfim.console.pages.visitors import IDLE_S, OF_ALL, OF_ONE, PageVisitor
from delfim.console.tapes.replay import open_tapes
from delfim.console.watch.operators import OperatorsFile
from delfim.parts.fleet.broker import UP, BrokerLine, BrokerPlace
from delfim.services.access.connection_limits import ConnectionLimits

TICK_S: Final = 0.05
BROKER_FRAMES: Final = 1024  # that wait for the broker: some for each boat of a fleet


async def serve(
    gateway: Gateway,
    boats: tuple[str, int] | None,
    page: tuple[str, int],
    ready: Callable[[str], None],
    tls: ssl.SSLContext | None = None,
    end_s: float = 1.0,
) -> None:
    """Serves until cancelled; without `boats` no UDP socket is opened. Open pages have `end_s` to end. Raises ConfigError for
    an unavailable address."""
    loop = asyncio.get_running_loop()
    visits = logging.getLogger(f"{__name__}.visits")
    visits.addFilter(_is_news)
    runner = web.AppRunner(gateway.app, access_log=None, logger=visits, shutdown_timeout=end_s)
    transports, listener = list[asyncio.DatagramTransport](), None
    try:
        if boats is not None:
            with _refused("--boats", boats):
                transports.append((await loop.create_datagram_endpoint(lambda: gateway.udp, local_addr=boats))[0])
                place = boats[0], 0  # any port: cameras answer where they are asked from
                transports.append((await loop.create_datagram_endpoint(lambda: gateway.pictures.udp, local_addr=place))[0])
            gateway.heard_on.insert(0, f"{boats[0]}:{boats[1]}")
        await runner.setup()
        assert runner.server is not None  # since setup
        with _refused("--page", page):
            visitor = partial(PageVisitor, runner.server, ConnectionLimits(OF_ALL, OF_ONE), visits)
            late_s = IDLE_S if tls else None
            listener = await loop.create_server(visitor, *page, ssl=tls, ssl_handshake_timeout=late_s)
        for each in gateway.radios.values():
            each.start()
        port = listener.sockets[0].getsockname()[1]
        key = "KEY" if gateway.bridge.operators.closed else gateway.token
        ready(f"http{'s' if tls else ''}://{bracketed(ip_address(page[0]))}:{port}/?token={key}")
        async with asyncio.TaskGroup() as group:
            if gateway.broker is not None:
                group.create_task(gateway.broker.follow())
            if gateway.push is not None:
                group.create_task(gateway.push.follow())
            try:
                while True:
                    await asyncio.sleep(TICK_S)
                    gateway.tick()
            finally:
                gateway.fleet.release_all("the console ended")
                if gateway.broker is not None:
                    await gateway.broker.flush()
    finally:
        if listener is not None:
            listener.close()
        await runner.cleanup()
        for transport in transports:
            transport.close()
        gateway.close()


def _is_news(record: logging.LogRecord) -> bool:
    """Malformed HTTP is no news: a visitor could fill the terminal with it."""
    return not (record.exc_info and isinstance(record.exc_info[1], HttpProcessingError))


@contextmanager
def _refused(option: str, address: tuple[str, int]) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        cause = error.__cause__ if isinstance(error.__cause__, OSError) else error  # of uvloop's own error, which has no number
        taken = cause.errno == errno.EADDRINUSE
        reason = (
            f"another program has it, perhaps another console; choose with {option} ADDRESS:PORT" if taken else cause.strerror
        )
        raise ConfigError(option, f"{address[0]}:{address[1]}", str(reason)) from None


def run(asked: argparse.Namespace) -> int:
    """The command."""
    host, port = _address("--page", asked.page)
    tapes = open_tapes([Path(each) for each in asked.replay]) if asked.replay else []
    gateway = Gateway(
        WakefulClock(),
        Path(asked.missions),
        Key(Path(asked.key)) if asked.key else None,
        kept_token(Path(asked.token).expanduser()),
        Path(asked.vehicle) if asked.vehicle else None,
        charts=Path(asked.charts),
        radios=() if tapes else asked.radio,
        sessions=Path(asked.sessions),
        tapes=tapes,
        number=asked.number,
        trials=Path(asked.trials),
        operators=OperatorsFile(Path(asked.operators).expanduser()),
    )
    gateway.pictures.replays(tapes)
    gateway.aboard.fetches(sources_of(asked.logs), Path(asked.logs_into))
    if asked.broker and not tapes:
        gateway.broker = broker_line(gateway, asked)
        gateway.heard_on.append(gateway.broker.place.host)
    view = FoxgloveView(asked.foxglove) if asked.foxglove is not None else None
    if view is not None:
        gateway.viewers.append(view.tell)

    def ready(url: str) -> None:
        what = (
            f"{len(tapes)} recordings are replayed"
            if tapes
            else f"boats are heard on {', '.join(filter(None, [asked.boats, *asked.radio, asked.broker]))}"
        )
        print(f"delfim: the console is at {url}; {what}; it is console {gateway.me}", flush=True)
        if view is not None:
            print(
                f"delfim: Foxglove: open the connection {view.url}; a layout is at {url.replace('/?', '/foxglove.json?')}",
                flush=True,
            )
        for complaint in filter(None, [*gateway.charts.faults, *(tape.complaint for tape in tapes)]):
            print(f"delfim: {complaint}", file=sys.stderr)
        if asked.browser and not gateway.bridge.operators.closed:
            show(url)

    async def until_ended() -> None:
        """Ends in order: zero thrust to boats driven by hand, the session to the disk."""
        serving = asyncio.current_task()
        assert serving is not None
        with suppress(NotImplementedError):  # on Windows Ctrl-C is raised instead
            for number in (signal.SIGINT, signal.SIGTERM):
                asyncio.get_running_loop().add_signal_handler(number, serving.cancel)
        await serve(gateway, None if tapes else _address("--boats", asked.boats), (host, port), ready)

    try:
        with suppress(KeyboardInterrupt, asyncio.CancelledError), asyncio.Runner(loop_factory=_new_loop(asked)) as runner:
            runner.run(until_ended())
    finally:
        if view is not None:
            view.close()
    return 0


def broker_line(gateway: Gateway, asked: argparse.Namespace) -> BrokerLine:
    """The connection to the broker of the command line. Raises ConfigError."""
    if find_spec("aiomqtt") is None:
        raise ConfigError("--broker", asked.broker, "it needs: pip install 'delfim[fleet]'")
    if not asked.key:
        raise ConfigError("--broker", asked.broker, "anybody may speak there: name the boats' key with --key")
    place, clock = BrokerPlace.of(asked.broker), WakefulClock()
    if asked.broker_credentials and not (place.tls or place.host in ("localhost", "127.0.0.1", "::1")):
        raise ConfigError("--broker", asked.broker, "the password would go over the network in the clear: write mqtts")
    files = {"credentials": asked.broker_credentials, "authorities": asked.broker_authorities}
    return BrokerLine(place, place.topic("+", UP), gateway.hear_of, clock, held=BROKER_FRAMES, **files)


def _new_loop(asked: argparse.Namespace) -> Callable[[], asyncio.AbstractEventLoop]:
    """The client of the broker watches its socket, which Windows' other loop cannot."""
    return asyncio.SelectorEventLoop if sys.platform == "win32" and asked.broker else new_event_loop


def _address(option: str, text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    try:
        ip_address(host)
        if not 0 <= int(port) < 1 << 16:
            raise ValueError
        return host, int(port)
    except ValueError:
        raise ConfigError(option, text, "not an address", "ADDRESS:PORT") from None

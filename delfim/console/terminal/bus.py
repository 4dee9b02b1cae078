"""`delfim can`: see a bus, send, make traffic, play back a log; on SocketCAN, canloop, any adapter, or by TCP from cantcpd.

Options and output are those of can-utils (candump, cansend, cangen, canplayer) as far as they go. `stat` has a file of its own.
"""

import argparse
import contextlib
import gzip
import random
import select
import socket
import sys
import time
import zlib
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple, TextIO

from delfim.base.errors import ConfigError, FormatError
from delfim.base.frames import CAN_ERR, Frame, extended, standard
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanSocket, bus_state
from delfim.console.terminal import busstat, nodes
from delfim.console.terminal.framefilter import Filter, Stamps, decoder, long_text, parse_filter, parse_frame
from delfim.logging.candump import format_line, parse_line

LINE_MAX: Final = 200  # characters; a frame has half of them
DRAIN: Final = 64  # frames of one bus before the next one has its turn
BUS: Final = "can0 | canloop:NAME | python-can:INTERFACE:CHANNEL | socketcand:HOST:PORT:BUS"


class ListenedBus(NamedTuple):
    """A bus that is listened to."""

    can: CanSocket
    wanted: Filter

    def device(self, frame: Frame) -> str:
        """The name of the interface that a frame came by, as logs have it."""
        if self.can.name == "any":
            with contextlib.suppress(OSError):
                return socket.if_indextoname(frame.ifindex)
        return self.can.name.rpartition(":")[2]


def opened(texts: Sequence[str], links: contextlib.ExitStack) -> list[ListenedBus]:
    """Buses and their filters, "can0,123:7FF". Raises BusError, FormatError."""
    sources = []
    for text in texts:
        interface, wanted = parse_filter(text)
        can = links.enter_context(open_can(interface, error_frames=bool(wanted.errors)))
        can.bind(ANYTHING)
        can.setblocking(False)
        sources.append(ListenedBus(can, wanted))
    return sources


def frames(sources: Sequence[ListenedBus], silence_s: float | None = None) -> Iterator[tuple[ListenedBus, Frame]]:
    """The frames of the buses that pass the filters, until none came for `silence_s`."""
    poll = select.poll()
    by_fd = {source.can.fileno(): source for source in sources}
    for fd in by_fd:
        poll.register(fd, select.POLLIN)
    heard_s = time.monotonic()
    while silence_s is None or time.monotonic() - heard_s < silence_s:
        for fd, _ in poll.poll(None if silence_s is None else (heard_s + silence_s - time.monotonic()) * 1000):
            source = by_fd[fd]
            for _ in range(DRAIN):
                frame = source.can.receive()
                if frame is None:
                    break
                if source.wanted.passes(frame):
                    heard_s = time.monotonic()
                    yield source, frame


def dump(asked: argparse.Namespace) -> int:
    """candump."""
    with contextlib.ExitStack() as links:
        show = Show(asked)
        sources = opened(asked.bus, links)
        if asked.log:
            name = time.strftime("candump-%Y-%m-%d_%H%M%S.log")
            print(f"Enabling Logfile '{name}'", file=sys.stderr)
            show.out = links.enter_context(open(name, "x", encoding="ascii", newline="\n"))
        show.width = max(len(source.can.name.rpartition(":")[2]) for source in sources)
        lost = {source.can.name: 0 for source in sources}
        silence_s = asked.silence_ms / 1000 if asked.silence_ms else None
        for count, (source, frame) in enumerate(frames(sources, silence_s), 1):
            name, total = source.can.name, source.can.dropped
            if total != lost[name]:
                print(f"dropped {total - lost[name]} CAN frames on {name!r} (total {total})", file=sys.stderr)
                lost[name] = total
            show.frame(source.device(frame), frame)
            if count == asked.count:
                break
    return 0


class Show:
    """The output of frames, and their format there."""

    def __init__(self, asked: argparse.Namespace) -> None:
        self.width = 0
        self.out: TextIO = sys.stdout
        self._asked, self._stamps, self._wide = asked, Stamps(asked.stamps), False
        self._decode = decoder(asked.dbc) if asked.dbc else None
        self._is_log = asked.log or asked.log_format
        if self._is_log and (asked.ascii or asked.dbc or asked.error_words):
            raise ConfigError("delfim can dump", "-l, -L", "the log format has no room for -a, -e and --dbc")

    def frame(self, device: str, frame: Frame) -> None:
        if self._is_log:
            line = format_line(frame, device.rjust(self.width))
            print(line[:-1] if self._asked.extra else line[:-3], file=self.out, flush=True)
            return
        self._wide = self._wide or frame.extended
        extra = f"  {'TX' if frame.sent_here else 'RX'} - -" if self._asked.extra else ""
        text = long_text(frame, wide=self._wide, ascii_too=self._asked.ascii)
        meaning = self._decode(frame) if self._decode else ""
        if self._asked.error_words and frame.arb & CAN_ERR and (state := bus_state(frame)):
            counters = f", errors tx {state.transmit_errors} rx {state.receive_errors}" * (state.transmit_errors is not None)
            meaning = state.state + counters
        stamp = self._stamps.text(frame.t_ns)
        print(f" {stamp} {device.rjust(self.width)}{extra}  {text}{'   ' if meaning else ''}{meaning}", flush=True)


def send(asked: argparse.Namespace) -> int:
    """cansend."""
    wanted = [parse_frame(text) for text in asked.frame]
    with open_can(asked.bus) as can:
        for frame in wanted:
            can.sendmsg(frame)
        can.confirm()
    return 0


def generate(asked: argparse.Namespace) -> int:
    """cangen."""
    chance, due_s = random.Random(asked.seed), time.monotonic()
    with open_can(asked.bus) as can:
        number = 0
        while asked.count is None or number < asked.count:
            can.sendmsg(generated(asked, chance, number))
            number += 1
            due_s = max(due_s + asked.gap_ms / 1000, time.monotonic() - asked.gap_ms / 1000)
            time.sleep(max(0.0, due_s - time.monotonic()))
        can.confirm()
    return 0


def generated(asked: argparse.Namespace, chance: random.Random, number: int) -> Frame:
    """The frame with this number, after cangen's modes: r (random), i (incremented), or a fixed value."""
    bits = 29 if asked.extended else 11
    identifier = _moded("-I", asked.identifier, chance.getrandbits(bits), number, 16) % (1 << bits)
    length = _moded("-L", asked.length, chance.randrange(9), number % 9, 10)
    if not 0 <= length <= 8:
        raise FormatError(f"-L {asked.length}: a CAN frame has 0 to 8 bytes")
    if asked.data == "i":
        data = number.to_bytes(16, "little")[: length or 1]
    elif asked.data == "r":
        data = chance.randbytes(length)
    else:
        try:
            data = bytes.fromhex(asked.data)
        except ValueError:
            raise FormatError(f"-D {asked.data}: neither r, i nor hexadecimal") from None
        data = (data + bytes(8))[: length if asked.length != "r" else min(len(data), 8)]
    return Frame((extended if asked.extended else standard)(identifier), data)


def _moded(option: str, mode: str, random_value: int, number: int, base: int) -> int:
    if mode in ("r", "i"):
        return random_value if mode == "r" else number
    try:
        return int(mode, base)
    except ValueError:
        raise FormatError(f"{option} {mode}: neither r, i nor a number") from None


def replay(asked: argparse.Namespace) -> int:
    """canplayer."""
    outlets = dict(_assignment(text) for text in asked.assignment)
    with contextlib.ExitStack() as links:
        buses: dict[str, CanSocket] = {}
        sent = skipped = 0
        for _ in range(asked.loops):
            start_s, first_ns, before_ns = time.monotonic(), None, 0
            for device, frame in logged(asked.file):
                if (outlets and device not in outlets) or frame.arb & CAN_ERR:
                    skipped += 1
                    continue
                if first_ns is None:
                    first_ns = before_ns = frame.t_ns
                if asked.skip_s is not None and frame.t_ns - before_ns > asked.skip_s * 1e9:
                    first_ns += frame.t_ns - before_ns
                before_ns = frame.t_ns
                if not asked.at_once:
                    time.sleep(max(0.0, start_s + (frame.t_ns - first_ns) / 1e9 / asked.speed - time.monotonic()))
                name = outlets.get(device, device)
                if name not in buses:
                    buses[name] = links.enter_context(open_can(name))
                buses[name].sendmsg(frame._replace(ifindex=0))
                sent += 1
        for each in buses.values():
            each.confirm()
    print(f"delfim can replay: {sent} frames sent, {skipped} left out", file=sys.stderr)
    return 0


def _assignment(text: str) -> tuple[str, str]:
    outlet, equals, device = text.partition("=")
    if not (outlet and equals and device):
        raise FormatError(f"not an assignment: {text!r}; write BUS=NAME, where NAME is the one in the log")
    return device, outlet


def logged(file: str) -> Iterator[tuple[str, Frame]]:
    """Device and frame of the lines of a candump log, plain or .gz; other lines are passed over. A log that a power cut left
    unfinished ends where it can be read no further. Raises FormatError where the file cannot be read at all."""
    try:
        with gzip.open(file, "rt") if Path(file).suffix == ".gz" else open(file) as lines:
            for line in iter(partial(lines.readline, LINE_MAX), ""):
                if line.startswith("("):
                    with contextlib.suppress(FormatError):
                        yield parse_line(line)
    except (EOFError, zlib.error, gzip.BadGzipFile, UnicodeDecodeError) as error:
        print(f"delfim can replay: {file} ends early: {error}", file=sys.stderr)
    except OSError as error:
        raise FormatError(f"{file}: {error.strerror}") from None


def options(parser: argparse.ArgumentParser) -> None:
    """The tools, each with its function as `run`."""
    tools = parser.add_subparsers(title="tools", required=True, metavar="TOOL")
    one = tools.add_parser("dump", help="print frames (candump)", description="Print frames, as candump does.")
    one.set_defaults(run=dump)
    one.add_argument("bus", nargs="+", metavar="BUS[,FILTER]", help=f"{BUS}; filters ID:MASK, ID~MASK, #ERRORMASK, j")
    one.add_argument("-t", dest="stamps", default="", choices="adzA", help="stamps: absolute, delta, since zero, with date")
    one.add_argument("-l", dest="log", action="store_true", help="into a new file candump-DATE_TIME.log")
    one.add_argument("-L", dest="log_format", action="store_true", help="log format on standard output")
    one.add_argument("-n", dest="count", type=int, metavar="COUNT", help="end after so many frames")
    one.add_argument("-T", dest="silence_ms", type=float, metavar="MS", help="end when nothing came for so long")
    one.add_argument("-a", dest="ascii", action="store_true", help="data as letters, too")
    one.add_argument("-x", dest="extra", action="store_true", help="whether received, or sent by this computer")
    one.add_argument("-e", dest="error_words", action="store_true", help="say what error frames mean")
    one.add_argument("--dbc", metavar="FILE", help="say what frames mean after this database, as etc/delfimx.dbc")
    one = tools.add_parser("send", help="send frames (cansend)", description="Send frames, as cansend does.")
    one.set_defaults(run=send)
    one.add_argument("bus", metavar="BUS", help=BUS)
    one.add_argument("frame", nargs="+", metavar="FRAME", help="123#DEADBEEF, 12345678#11.22 (extended), 123#R4 (remote)")
    _add_traffic(tools)
    busstat.add_parser(tools, BUS)
    nodes.add_parsers(tools, BUS)


def _add_traffic(tools: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    one = tools.add_parser("gen", help="make traffic (cangen)", description="Make traffic, as cangen does.")
    one.set_defaults(run=generate)
    one.add_argument("bus", metavar="BUS", help=BUS)
    one.add_argument("-g", dest="gap_ms", type=float, default=200.0, metavar="MS", help="between frames (%(default)g)")
    one.add_argument("-e", dest="extended", action="store_true", help="extended frames")
    one.add_argument(
        "-I", dest="identifier", default="r", metavar="MODE", help="identifier: r(andom), i(ncremented), hexadecimal"
    )
    one.add_argument("-L", dest="length", default="r", metavar="MODE", help="length: r, i, 0 to 8")
    one.add_argument("-D", dest="data", default="r", metavar="MODE", help="data: r, i, hexadecimal")
    one.add_argument("-n", dest="count", type=int, metavar="COUNT", help="end after so many frames")
    one.add_argument("--seed", type=int, metavar="NUMBER", help="the same random frames each time")
    one = tools.add_parser("replay", help="play back a log (canplayer)", description="Send what a candump log holds.")
    one.set_defaults(run=replay)
    one.add_argument("file", metavar="FILE", help="a log of candump or of the black box, .gz or not")
    one.add_argument("assignment", nargs="*", metavar="BUS=NAME", help="send on BUS what the log has from NAME, only")
    one.add_argument("-t", dest="at_once", action="store_true", help="without regard to stamps")
    one.add_argument("-l", dest="loops", type=int, default=1, metavar="COUNT", help="so many times (%(default)s)")
    one.add_argument("-s", dest="skip_s", type=float, metavar="SECONDS", help="skip silences longer than this")
    one.add_argument("--speed", type=float, default=1.0, metavar="FACTOR", help="times as fast as recorded")

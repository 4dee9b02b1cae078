"""`delfim iridium`: ashore, an order to a boat as a message for the satellite, and what a boat's message says."""

import argparse
import secrets
from pathlib import Path

from delfim.base.errors import DelfimError


def options(parser: argparse.ArgumentParser) -> None:
    kinds = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    order = kinds.add_parser("order", help="Write an order as a message, to be sent as an e-mail's attachment, or as hex.")
    order.add_argument("--key", required=True, metavar="FILE", type=Path, help="The key of console and boat.")
    order.add_argument(
        "boat", type=int, choices=range(1, 250), metavar="NUMBER", help="The boat's number, boat.id of its file."
    )
    order.add_argument(
        "order", metavar="ORDER", help="stop, hold, home, or a position as 38.69,-9.21; in the south with -- before it."
    )
    order.add_argument("output", metavar="FILE", type=Path, help="The message, as order.sbd.")
    read = kinds.add_parser("read", help="Say what messages of a boat say.")
    read.add_argument("--key", metavar="FILE", type=Path, help="The key: without it nobody knows who wrote a message.")
    read.add_argument("message", nargs="+", metavar="FILE", type=Path, help="Messages as the gateway delivers them, .sbd.")


def run(asked: argparse.Namespace) -> int:
    return _order(asked) if asked.what == "order" else _read(asked)


def _order(asked: argparse.Namespace) -> int:
    from delfim.base.clock import SystemClock
    from delfim.base.input.keys import read_key
    from delfim.parts.iridium import orders
    from delfim.parts.mavlink.codec.signing import Signing

    number = secrets.randbits(32)
    message = orders.sealed(orders.meant(asked.order), asked.boat, number, Signing(read_key(asked.key), SystemClock()))
    try:
        asked.output.write_bytes(message)
    except OSError as error:
        raise DelfimError(f"{asked.output}: {error.strerror}") from None
    print(f"order {number}, {len(message)} bytes, in {asked.output}; as hex:\n{message.hex()}")
    return 0


def _read(asked: argparse.Namespace) -> int:
    from delfim.base.input.keys import read_key
    from delfim.parts.iridium import reading

    key = read_key(asked.key) if asked.key else None
    for file in asked.message:
        try:
            data = file.read_bytes()[: reading.MOST]
        except OSError as error:
            raise DelfimError(f"{file}: {error.strerror}") from None
        for line in reading.in_words(data, key):
            print(f"{file}: {line}")
    return 0

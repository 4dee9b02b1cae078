"""`delfim shore`: the shore's end of the radio's line."""

import argparse


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("device", metavar="DEVICE", help="Serial port of the radio, such as /dev/ttyUSB0.")
    parser.add_argument(
        "--boats",
        required=True,
        metavar="ADDRESS[=STATION],...",
        help="The boats: one address alone, or several on one frequency, each with its slipd.station: 10.0.0.1=1,10.0.0.3=2.",
    )
    parser.add_argument(
        "--address", default="10.0.0.2/24", metavar="ADDRESS/PREFIX", help="Of this computer: slipd.peer of all boats."
    )
    parser.add_argument("--baud", type=int, default=115_200, help="Of the port.")
    parser.add_argument(
        "--radio-bps", type=int, default=0, metavar="BIT/S", help="Of the radio, if it is slower than its port; else 0."
    )
    parser.add_argument("--encapsulation", choices=("slip", "cslip"), default="cslip", help="As in the boats' files.")
    parser.add_argument("--mtu", type=int, default=296, metavar="BYTES", help="As in the boats' files.")
    parser.add_argument("--interface", default="radio0", metavar="NAME", help="Name of the network interface.")
    told = "From a poll to its answer, at most, on the way through both radios: shorter, and boats talk over each other."
    parser.add_argument("--turnaround", type=float, default=0.1, metavar="S", help=told)
    told = "Of one turn, each way: longer turns carry more, shorter ones make urgent packets sooner."
    parser.add_argument("--airtime", type=float, default=0.1, metavar="S", help=told)


def run(asked: argparse.Namespace) -> int:
    import sys

    from delfim.base.errors import DelfimError

    if sys.platform != "linux":
        raise DelfimError(
            "delfim shore needs Linux (TUN); elsewhere MAVLink goes over the port: delfim console --radio (docs/shore.md)"
        )
    from delfim.services.radio.shore import run, stations

    slipd = {
        "device": asked.device,
        "baud": asked.baud,
        "radio_bps": asked.radio_bps,
        "encapsulation": asked.encapsulation,
        "mtu": asked.mtu,
        "interface": asked.interface,
    }
    return run(slipd, asked.address, stations(asked.boats, asked.address), asked.turnaround, asked.airtime)

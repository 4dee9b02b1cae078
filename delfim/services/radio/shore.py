"""The shore's end of the radio's line, without a vehicle's file: one boat alone, or several by polls (docs/shore.md)."""

import asyncio
import logging
from collections.abc import Mapping
from ipaddress import IPv4Address, IPv4Interface
from typing import Final

from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.errors import ConfigError
from delfim.services.radio import slipd
from delfim.services.radio.polling import PollingShore
from delfim.services.runtime import LoadedService, Runtime
from delfim.services.tables import Slipd

COMMAND: Final = "delfim shore"
TURNAROUND_S, AIRTIME_S = (0.005, 5.0), (0.01, 5.0)  # ranges


def stations(words: str, network: str) -> dict[IPv4Address, int]:
    """Parse the boats of `10.0.0.1=1,10.0.0.3=2`; of one address alone the station is 0: nobody polls it. Raises
    ConfigError."""
    boats = dict[IPv4Address, int]()
    reach = _interface(network)
    for word in words.split(","):
        address, _, station = word.partition("=")
        try:
            boat, number = IPv4Address(address), int(station or "0")
        except ValueError:
            raise _refused("--boats", f"{word!r} is not ADDRESS=STATION, such as 10.0.0.1=1") from None
        if not 0 <= number <= 254:
            raise _refused("--boats", f"{word!r}: a station is a number from 1 to 254")
        if boat == reach.ip or (number and boat not in reach.network):
            raise _refused("--boats", f"{boat} is not another address of {reach.network}, the network of --address {network}")
        if boat in boats or (number and number in boats.values()):
            raise _refused("--boats", f"{word!r}: another boat has this address or this station")
        boats[boat] = number
    if len(boats) > 1 and 0 in boats.values():
        raise _refused("--boats", "of several boats each needs a station: 10.0.0.1=1,10.0.0.3=2")
    return boats


def run(
    table: Mapping[str, object], network: str, boats: Mapping[IPv4Address, int], turnaround_s: float, airtime_s: float
) -> int:
    """Run until SIGTERM or SIGINT; returns the exit code. `table` is that of slipd in a vehicle's file, from the shore's point
    of view. Raises ConfigError."""
    for name, value, (least, most) in (("--turnaround", turnaround_s, TURNAROUND_S), ("--airtime", airtime_s, AIRTIME_S)):
        if not least <= value <= most:
            raise _refused(name, f"{value:g} is not from {least:g} to {most:g} s")
    ends = {"address": str(_interface(network).ip), "peer": str(next(iter(boats)))}
    settings = config.read({"boat": {"name": "shore"}, "slipd": {**table, **ends}}, COMMAND)

    async def serve(runtime: Runtime) -> None:
        line, loop = settings.of(Slipd), asyncio.get_running_loop()
        bytes_per_s = (line.radio_bps or line.baud) / 10.0  # a byte has 10 bits: 8N1
        known = {address.packed: station for address, station in boats.items()}

        def open_line(port: int) -> slipd.RadioLine:
            shore = PollingShore(known, line.encapsulation == "cslip", bytes_per_s, turnaround_s, airtime_s, line.mtu)
            return slipd.polled(port, line, shore, runtime, loop, network)

        await slipd.keep_up(runtime, line, open_line)

    logging.basicConfig(format="%(asctime)s %(message)s", level=logging.INFO)
    row = LoadedService("slipd", serve if all(boats.values()) else slipd.serve)
    return Runtime(settings, SystemClock(), alone=True, new_loop=asyncio.new_event_loop).main([row])


def _interface(network: str) -> IPv4Interface:
    try:
        return IPv4Interface(network)
    except ValueError:
        raise _refused("--address", f"{network!r} is not ADDRESS/PREFIX, such as 10.0.0.2/24") from None


def _refused(option: str, reason: str) -> ConfigError:
    return ConfigError(COMMAND, option, reason)

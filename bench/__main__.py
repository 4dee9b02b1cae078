"""`make bench`, or `python -m bench` in a checkout: the figures of the design, measured on this machine."""

import argparse
import sys
from collections.abc import Sequence

from delfim.base.errors import DelfimError, in_words
from delfim.commands import Formatter, overrides

PROGRAMS = ("critical-path", "costs", "allocation", "sim", "log", "watchers", "datagrams", "floods", "downloads", "disk")
APART = ("campaign", "fleet", "soak", "peers", "avoiding")


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__, formatter_class=Formatter)
    parser.add_argument("what", nargs="?", choices=[*PROGRAMS, *APART], help="Without a name, all but the last five.")
    parser.add_argument("--file", default="etc/delfimx.toml", help="The vehicle's file.")
    overrides(parser)
    parser.add_argument("--output", default="run/bench", metavar="DIRECTORY", help="Write results and pictures here.")
    parser.add_argument("--seconds", type=float, help="Length of a slice of the critical path, or of the voyage of sim.")
    parser.add_argument("--rounds", type=int, help="How often each program has a turn.")
    parser.add_argument("--rates", type=float, nargs="+", metavar="HZ", help="Rates of navigation (default: 5 100 500).")
    parser.add_argument("--bus", metavar="INTERFACE", help="Measure on a Linux CAN interface instead of loopback buses.")
    parser.add_argument("--frames", type=int, default=7700, help="Frames a second on the full bus; 7700 fill 1 Mbit/s.")
    parser.add_argument(
        "--wire-us", type=int, default=0, help="Pause between the frames of a message; 130 is a bus of 1 Mbit/s (default: 0)."
    )
    parser.add_argument("--quick", action="store_true", help="Take about a minute: whether it works, not how fast it is.")
    parser.add_argument("--minutes", type=float, default=60.0, help="Length of soak.")
    parser.add_argument("--long", action="store_true", help="Under load, against C alone: 150,645 cycles, or --rounds of them.")
    return parser


def run(asked: argparse.Namespace) -> int:
    from bench import allocation, avoiding, campaign, costs, critical_path, fleet, liblog, lockstep, peers, sides, soak

    programs = {
        "critical-path": critical_path.run,
        "costs": costs.run,
        "allocation": allocation.run,
        "sim": lockstep.run,
        "log": liblog.run,
        "watchers": sides.run_watchers,
        "datagrams": sides.run_datagrams,
        "floods": sides.run_floods,
        "downloads": sides.run_downloads,
        "disk": sides.run_disk,
        "campaign": campaign.run,
        "fleet": fleet.run,
        "soak": soak.run,
        "peers": peers.run,
        "avoiding": avoiding.run,
    }
    return max(programs[name](asked) for name in ([asked.what] if asked.what else PROGRAMS))


def main(arguments: Sequence[str] | None = None) -> int:
    try:
        return run(options().parse_args(arguments))
    except KeyboardInterrupt:
        return 130
    except (DelfimError, OSError) as error:
        print(f"bench: {in_words(error)}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())

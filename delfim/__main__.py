"""The command line: `delfim COMMAND ...`. Errors that a person can mend are one line on standard error and exit code 2."""

import argparse
import contextlib
import sys
from collections.abc import Callable, Sequence
from typing import Any

from delfim import __version__
from delfim.errors import DelfimError, PermanentFailure, Refused, in_words

EXIT_REFUSED, EXIT_WRONG, EXIT_PERMANENT = 1, 2, 100  # 100 tells the supervisor: do not start me again
SIMULATED = "run/sim"  # where `delfim sim` keeps its logs and sockets


def main(arguments: Sequence[str] | None = None) -> int:
    parser = _parser()
    asked, more = parser.parse_known_args(arguments)
    if more and "words" not in asked:
        parser.error(f"unrecognized arguments: {' '.join(more)}")
    if more:  # argparse finds the words of a command behind its options only where no option stands before them
        asked.words += more
    try:
        code: int = asked.run(asked)
        return code
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # `delfim ... | head`
        return 0
    except Refused as refusal:
        print(f"delfim: {refusal}", file=sys.stderr)
        return EXIT_REFUSED
    except PermanentFailure as failure:
        print(f"delfim: {failure}", file=sys.stderr)
        return EXIT_PERMANENT
    except (DelfimError, OSError) as error:  # the latter: no permission, no such folder, a full disk
        print(f"delfim: {in_words(error)}", file=sys.stderr)
        return EXIT_WRONG


# Each command imports what it needs when it runs: a boat does not load what draws pictures.


def _check(asked: argparse.Namespace) -> int:
    from delfim.config import load

    vehicle = load(asked.file, asked.set)
    print(f"{asked.file}: {vehicle.boat.name} is fit to be built")
    return 0


def _describe(asked: argparse.Namespace) -> int:
    from delfim.console.describe import describe

    print(describe(), end="")
    return 0


def _supervise(asked: argparse.Namespace) -> int:
    from delfim.suite import rescue, supervise

    if not asked.init:
        return supervise(asked.file, asked.set)
    try:
        return supervise(asked.file, asked.set, init=True)
    except Exception as error:
        rescue(error)
        raise


def _shutdown(asked: argparse.Namespace) -> int:
    from delfim.suite import shut_down

    return shut_down(asked.file, asked.set, "reboot" if asked.reboot else "off")


def _run(asked: argparse.Namespace) -> int:
    from delfim.suite import run

    return run(asked.file, asked.set, service=asked.service, beat_fd=asked.beat_fd)


def _password(asked: argparse.Namespace) -> int:
    import getpass

    from delfim.services.door import hashed

    print(hashed(getpass.getpass("password: ")))
    return 0


def _nodes(asked: argparse.Namespace) -> int:
    from delfim.config import load
    from delfim.simulator.realtime import run_nodes

    return run_nodes(load(asked.file, asked.set), asked.seed)


def _guest(asked: argparse.Namespace) -> int:
    import asyncio

    from delfim.config import load
    from delfim.simulator.guest import Zigzag, guest

    host, _, port = load(asked.file, asked.set).guest.listen.rpartition(":")
    asyncio.run(guest(host, int(port), Zigzag(course_deg=asked.course, amplitude_deg=30.0, leg_s=20.0, speed_mps=1.2)))
    return 0


def _sim(asked: argparse.Namespace) -> int:
    if asked.scenario:
        return _scenario(asked)
    from delfim.live import simulate

    return simulate(asked)


def _scenario(asked: argparse.Namespace) -> int:
    from delfim.simulator import campaign, scenario

    if asked.scenario == campaign.MIXED:
        result = campaign.sail_mixed(asked.file, asked.seed, tuple(asked.set))
    else:
        result = scenario.run_file(asked.scenario, asked.file, asked.seed, tuple(asked.set))
    print(*scenario.report(result), sep="\n")
    if result.failures:
        print(f"delfim: failed; again: {campaign.again(asked.file, asked.scenario, asked.seed, asked.set)}", file=sys.stderr)
        return 1
    print(f"delfim: {asked.scenario}, seed {asked.seed}: all as it must be, {result.elapsed_s:.0f} s sailed")
    return 0


def _fault(asked: argparse.Namespace) -> int:
    from delfim.config import load
    from delfim.simulator.bycommand import tell

    print(f"delfim: {tell(load(asked.file, _there(asked)), asked.kind, asked.where, asked.value, asked.for_s)}")
    return 0


def _console(asked: argparse.Namespace) -> int:
    from pathlib import Path

    from delfim.console.gateway import run
    from delfim.console.mavlink import keygen

    if asked.keygen:
        keygen(Path(asked.keygen))
        print(f"delfim: {asked.keygen}: a new key; the boat needs the same file, brought there by hand")
        return 0
    return run(asked)


def _drive(asked: argparse.Namespace) -> int:
    from delfim.config import load
    from delfim.console.drive import run

    run(load(asked.file, _there(asked)).console.socket, asked.words)
    return 0


def _there(asked: argparse.Namespace) -> list[str]:
    """The overrides with which a running boat is found: those of `delfim sim`, where that is meant, and the operator's."""
    simulated = [f'console.socket="{SIMULATED}/command"', f'runtime.run_directory="{SIMULATED}"'] if asked.sim else []
    return [*simulated, *asked.set]


def _can(asked: argparse.Namespace) -> int:
    from delfim.console.bus import main as tools

    return tools(asked.words)


def _log(asked: argparse.Namespace) -> int:
    from delfim.logs import run

    return run(asked)


def _image(asked: argparse.Namespace) -> int:
    from delfim.image import run

    return run(asked)


def _bench(asked: argparse.Namespace) -> int:
    from delfim.bench import critical_path, liblog, lockstep, sides, soak

    programs = {
        "critical-path": critical_path.run,
        "sim": lockstep.run,
        "log": liblog.run,
        "watchers": sides.run_watchers,
        "datagrams": sides.run_datagrams,
        "downloads": sides.run_downloads,
        "disk": sides.run_disk,
    }
    if asked.what == "soak":
        return soak.run(asked)
    return max(programs[name](asked) for name in ([asked.what] if asked.what else programs))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="delfim", description="The onboard software of an autonomous surface vehicle.")
    parser.add_argument("--version", action="version", version=f"delfim {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    def command(name: str, run: object, text: str) -> argparse.ArgumentParser:
        one = commands.add_parser(name, help=text, description=text)
        one.set_defaults(run=run)
        one.add_argument("file", metavar="FILE", help="the vehicle's file, as etc/delfimx.toml")
        one.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override a key; the value is TOML")
        return one

    _add_supervision(command)
    run = command("run", _run, "Run the vehicle and its cooperative services in one process, without a supervisor.")
    run.add_argument("--service", metavar="NAME", help="only this service, in a process of its own")
    run.add_argument("--beat-fd", type=int, default=-1, help=argparse.SUPPRESS)
    command("check", _check, "Check a vehicle's file and say what is wrong with it.")
    text = "List every key of a vehicle's file with default, range and meaning."
    describe = commands.add_parser("describe", help=text, description=text)
    describe.set_defaults(run=_describe)
    text = "Ask for a password and print what a vehicle's file keeps of it."
    password = commands.add_parser("password", help=text, description=text)
    password.set_defaults(run=_password)
    nodes = command("nodes", _nodes, "Play the boat's other CAN nodes (navigation, GPS, propellers, batteries) on its bus.")
    nodes.add_argument("--seed", type=int, default=1, help="of noise and weather")
    guest = command("guest", _guest, "Play the guest computer: a zigzag, obeyed in mode grex.")
    guest.add_argument("--course", type=float, default=90.0, help="of the zigzag, degrees (%(default)s)")
    sim = command("sim", _sim, "Sail a mission in simulation: the whole suite, a modelled boat, a live view.")
    sim.add_argument("--mission", metavar="FILE", help="instead of the vehicle file's simulation.mission")
    sim.add_argument("--scenario", metavar="FILE", help='sail this scenario in lock step; "mixed": faults drawn from the seed')
    sim.add_argument(
        "--for", type=_seconds, dest="for_s", metavar="SECONDS", help="end after this time; otherwise with the mission"
    )
    sim.add_argument("--seed", type=int, default=1, help="of noise and weather")
    sim.add_argument("--lockstep", action="store_true", help="as fast as the machine can; same seed, same bytes")
    sim.add_argument("--plain", action="store_true", help="one line a second instead of the live view")
    sim.add_argument("--console", action="store_true", help="with the console, in the browser (docs/console.md)")
    sim.add_argument("--json", action="store_true", help="one JSON object a state")
    sim.add_argument("--output", default=SIMULATED, metavar="DIRECTORY", help="logs and pictures (%(default)s)")
    fault = command("fault", _fault, "Break something of a simulated boat, as `delfim sim` sails it (docs/scenarios.md).")
    _add_fault(fault)
    drive = command("drive", _drive, "Drive the boat from the command line: one command, or a prompt when none is given.")
    drive.add_argument("words", nargs="*", metavar="WORD", help="state | stop | heading DEG [M/S] | goto LAT LON | play | ...")
    for one in (fault, drive):
        one.add_argument("--sim", action="store_true", help=f"the boat of `delfim sim`, in {SIMULATED}")
    can = commands.add_parser(
        "can", add_help=False, help="See a bus, send, make traffic, statistics, play back a log: dump, send, gen, stat, replay."
    )
    can.add_argument("words", nargs=argparse.REMAINDER)
    can.set_defaults(run=_can)
    _add_console(commands)
    _add_log(commands)
    _add_image(command("image", _image, "The boat's image: look, install, confirm; two slots, the old one is kept."))
    _add_bench(commands)
    return parser


def _seconds(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0.0 < float(text) < float("inf"):
            return float(text)
    raise argparse.ArgumentTypeError(f"{text} is no number of seconds above 0")


def _add_console(commands: Any) -> None:
    text = "All boats on one screen, in the browser."
    console = commands.add_parser("console", help=text, description=text)
    console.add_argument(
        "--boats", default="127.0.0.1:14550", metavar="ADDRESS:PORT", help="where boats are heard (%(default)s)"
    )
    console.add_argument(
        "--radio", action="append", default=[], metavar="DEVICE:BAUD", help="a serial radio, as /dev/ttyUSB0:57600 or COM3:9600"
    )
    console.add_argument("--page", default="127.0.0.1:8765", metavar="ADDRESS:PORT", help="where the page is (%(default)s)")
    console.add_argument("--missions", default="missions", metavar="FOLDER", help="the operator's missions (%(default)s)")
    console.add_argument("--charts", default="charts", metavar="FOLDER", help="the operator's charts (%(default)s)")
    console.add_argument("--sessions", default="sessions", metavar="FOLDER", help="where sessions are recorded (%(default)s)")
    console.add_argument(
        "--replay", nargs="+", metavar="PATH", help="no boats: play these sessions (.tlog) and state logs, or folders of them"
    )
    console.add_argument("--key", metavar="FILE", help="signing key: the boats must have the same")
    console.add_argument("--vehicle", metavar="FILE", help="the vehicle's file, for dry runs of missions")
    console.add_argument("--keygen", metavar="FILE", help="make a signing key, and end")
    console.add_argument("--no-browser", dest="browser", action="store_false", help="do not open it")
    console.set_defaults(run=_console)


def _add_supervision(command: Callable[[str, object, str], argparse.ArgumentParser]) -> None:
    text = "Run the whole suite: starts, watches and restarts its processes; the dead-man."
    supervise = command("supervise", _supervise, text)
    supervise.add_argument("--init", action="store_true", help="as the machine's first process: ends with the machine")
    shutdown = command("shutdown", _shutdown, "End everything in order, so that the power may be cut (docs/powerd.md).")
    shutdown.add_argument("--reboot", action="store_true", help="start the computer again afterwards")


def _add_log(commands: Any) -> None:
    text = "Look at logs, convert, repeat, mend and fetch them: delfim log VERB --help."
    log = commands.add_parser("log", add_help=False, help=text)
    log.set_defaults(run=_log)
    log.add_argument("words", nargs=argparse.REMAINDER)


def _add_fault(fault: argparse.ArgumentParser) -> None:
    fault.add_argument("kind", metavar="KIND", help='navigation_silent, thruster_dead, ...; "end" ends all')
    fault.add_argument("where", metavar="WHERE", nargs="?", default="", help="of a sensor or thruster: gps, port, ...")
    fault.add_argument("--value", type=float, help="how much, where the kind has such a thing")
    fault.add_argument("--for", type=_seconds, dest="for_s", metavar="SECONDS", help="end after this time")


def _add_image(image: argparse.ArgumentParser) -> None:
    image.add_argument("verb", choices=["status", "verify", "install", "confirm"], help="verify and install name an image")
    image.add_argument("image", metavar="IMAGE", nargs="?", help="what `make image` packed, as it was uploaded")


def _add_bench(commands: Any) -> None:
    text = "Measure the contracts of the design on this machine (from a checkout of the sources)."
    bench = commands.add_parser("bench", help=text, description=text)
    bench.set_defaults(run=_bench)
    programs = ["critical-path", "sim", "log", "watchers", "datagrams", "downloads", "disk"]
    bench.add_argument("what", nargs="?", choices=[*programs, "soak"], help="without a name all but soak")
    bench.add_argument("--file", default="etc/delfimx.toml", help="the vehicle's file (%(default)s)")
    bench.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override a key of it")
    bench.add_argument("--output", default="run/bench", metavar="DIRECTORY", help="for JSON and pictures (%(default)s)")
    bench.add_argument("--seconds", type=float, help="of a slice of the critical path; of the sea in sim")
    bench.add_argument("--rounds", type=int, help="how often everybody has a turn")
    bench.add_argument("--rates", type=float, nargs="+", metavar="HZ", help="of navigation (5 100 500)")
    bench.add_argument("--bus", metavar="INTERFACE", help="a Linux CAN interface instead of loopback buses")
    bench.add_argument(
        "--frames", type=int, default=7700, help="a second on the full bus (%(default)s: 1 Mbit/s, never silent)"
    )
    bench.add_argument(
        "--wire-us", type=int, default=0, help="between the frames of a message; 130 is a bus of 1 Mbit/s (%(default)s)"
    )
    bench.add_argument("--quick", action="store_true", help="about a minute: whether it works, not how fast it is")
    bench.add_argument("--minutes", type=float, default=60.0, help="of soak (%(default)g)")
    bench.add_argument("--long", action="store_true", help="under load, against C alone: 150,645 cycles, or --rounds of them")


if __name__ == "__main__":
    sys.exit(main())

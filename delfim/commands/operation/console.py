"""`delfim console`: all boats on one screen, in the browser."""

import argparse

from delfim.commands import shipped


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--boats", default="127.0.0.1:14550", metavar="ADDRESS:PORT", help="Listen for boats here.")
    parser.add_argument(
        "--radio",
        action="append",
        default=[],
        metavar="DEVICE:BAUD",
        help="Listen to this serial radio, too: /dev/ttyUSB0:57600, COM3:9600.",
    )
    parser.add_argument(
        "--broker",
        metavar="mqtts://HOST:PORT/FLEET",
        help="Hear the boats of a fleet at this MQTT broker, too; needs --key.",
    )
    parser.add_argument(
        "--broker-credentials", default="", metavar="FILE", help="USER:PASSWORD for the broker, in one line; mode 0600."
    )
    parser.add_argument(
        "--broker-authorities",
        default="",
        metavar="FILE",
        help="PEM file of who signs the broker's certificate (default: those that this computer trusts).",
    )
    parser.add_argument("--page", default="127.0.0.1:8765", metavar="ADDRESS:PORT", help="Serve the page here.")
    parser.add_argument(
        "--number",
        type=int,
        choices=range(200, 255),
        metavar="NUMBER",
        help="This console's number, 200 to 254, by which boats tell consoles apart (default: drawn once and kept).",
    )
    parser.add_argument(
        "--token",
        default="~/.local/state/delfim/console.token",
        metavar="FILE",
        help="File of the browser's access token, which the printed address contains; made if missing.",
    )
    parser.add_argument("--missions", default="missions", metavar="FOLDER", help="The operator's missions.")
    parser.add_argument("--charts", default="charts", metavar="FOLDER", help="The operator's charts.")
    parser.add_argument("--trials", default="adopt", metavar="FOLDER", help="Keep trials of boats here (docs/adopt.md).")
    parser.add_argument(
        "--replay",
        nargs="+",
        metavar="PATH",
        help="Listen to no boats; replay these sessions (.tlog) and state logs, or folders of them.",
    )
    parser.add_argument("--key", metavar="FILE", help="Sign with this key; the boats must have the same.")
    parser.add_argument("--vehicle", metavar="FILE", type=shipped, help="The vehicle's file, for dry runs of missions.")
    _of_records(parser)
    _of_operators(parser)
    parser.add_argument("--keygen", metavar="FILE", help="Make a signing key in this file, and exit.")
    parser.add_argument(
        "--foxglove",
        type=int,
        nargs="?",
        const=8766,
        metavar="PORT",
        help="Show the boats in Foxglove, too, on this port of this computer (without PORT: 8766).",
    )
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="Do not open the browser.")


def _of_records(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--sessions", default="sessions", metavar="FOLDER", help="Record sessions here.")
    parser.add_argument(
        "--logs",
        action="append",
        default=[],
        metavar="NAME=URL",
        help="Where the logs of the boat of that name are, as for `delfim log fetch`: the page fetches them.",
    )
    parser.add_argument("--logs-into", default="logs", metavar="FOLDER", help="Put them here, in a folder of each boat.")


def _of_operators(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--operators",
        default="~/.local/state/delfim/operators.json",
        metavar="FILE",
        help="File of operators with roles and keys; while it names some, only their keys open the page.",
    )
    parser.add_argument(
        "--add-operator", metavar="NAME:ROLE", help="Add an operator (watch, command or maintain), print the key, and exit."
    )
    parser.add_argument(
        "--watch-log",
        type=float,
        metavar="HOURS",
        help="Print the log of the watch of the last HOURS, of all sessions in --sessions, as a table (CSV), and exit.",
    )
    parser.add_argument("--revoke-operator", metavar="NAME", help="Take an operator out of the file, and exit.")


def run(asked: argparse.Namespace) -> int:
    import time
    from pathlib import Path

    from delfim.console.gateway.serving import run
    from delfim.console.gateway.watchlog import since, table
    from delfim.console.link.mavlink import keygen
    from delfim.console.watch.operators import add_operator, revoke_operator

    operators = Path(asked.operators).expanduser()
    if asked.add_operator:
        name, _, role = asked.add_operator.rpartition(":")
        key = add_operator(operators, name, role)
        print(f"delfim: {name} has the role {role}; the page opens with ?token={key}: this key is told once, and kept nowhere")
        return 0
    if asked.revoke_operator:
        revoke_operator(operators, asked.revoke_operator)
        print(f"delfim: the key of {asked.revoke_operator} opens nothing any more")
        return 0
    if asked.watch_log is not None:
        print(table(since(Path(asked.sessions), time.time() - 3600.0 * asked.watch_log)), end="")
        return 0
    if asked.keygen:
        keygen(Path(asked.keygen))
        print(f"delfim: {asked.keygen}: a new key; copy this file to the boat by hand, never over the radio")
        return 0
    return run(asked)

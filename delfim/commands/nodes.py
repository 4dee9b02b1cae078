"""`delfim nodes`: the rest of the boat, played on its bus."""

import argparse

from delfim.commands import vehicle_file


def options(parser: argparse.ArgumentParser) -> None:
    vehicle_file(parser)
    parser.add_argument("--seed", type=int, default=1, help="Draw noise and gusts from this number.")


def run(asked: argparse.Namespace) -> int:
    from delfim.config import load
    from delfim.simulator.realtime import run_nodes

    return run_nodes(load(asked.file, asked.set), asked.seed)

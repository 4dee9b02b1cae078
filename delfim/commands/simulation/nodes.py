"""`delfim nodes`: simulates the boat's other nodes on its bus."""

import argparse

from delfim.commands import example_file


def options(parser: argparse.ArgumentParser) -> None:
    example_file(parser)
    parser.add_argument("--seed", type=int, default=1, help="Seed of noise and gusts.")


def run(asked: argparse.Namespace) -> int:
    from delfim.config import load
    from delfim.simulator.realtime.nodes import run_nodes

    return run_nodes(load(asked.file, asked.set), asked.seed)

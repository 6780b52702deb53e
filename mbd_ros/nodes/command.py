"""A parameter file to begin with: `mbd-ros params NODE`."""

import argparse
from importlib import import_module

from mbd_ros.errors import OK
from mbd_ros.jobs.progress import say_all
from mbd_ros.nodes.table import NODES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `params`."""
    parser.add_argument("node", choices=NODES, help="Node whose parameters are printed.")


def run(arguments: argparse.Namespace) -> int:
    """Print the parameter file of a node; the exit code."""
    from mbd_ros.nodes.shell.parameters import PARAMETERS
    from mbd_ros.nodes.shell.params_file import lines

    module, _, name = NODES[arguments.node].partition(":")
    node = getattr(import_module(module), name)
    say_all(lines(arguments.node, node.PARAMETERS + PARAMETERS))
    return OK

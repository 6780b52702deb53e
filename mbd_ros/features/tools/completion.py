"""Words of `mbd-ros completion`."""

import argparse
import sys

from mbd_ros.errors import OK
from mbd_ros.features.tools.completion_scripts import SHELLS, all_words


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `completion` understands."""
    parser.add_argument("shell", choices=list(SHELLS), help="whose language the script is in")


def run(arguments: argparse.Namespace) -> int:
    """Print the script; the exit code."""
    for line in SHELLS[arguments.shell](all_words()):
        sys.stdout.write(f"{line}\n")  # whole, for a program
    return OK

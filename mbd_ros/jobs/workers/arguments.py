"""Words that say where work is done."""

import argparse


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Where the work is done."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask cluster: tcp://host:8786, or local:N"
    )
    where.add_argument("--workers", type=_count, metavar="N", help="processes (default: cores)")


def _count(text: str) -> int:
    if not (text.isdecimal() and int(text)):
        raise argparse.ArgumentTypeError(f"{text!r} is no number > 0")
    return int(text)

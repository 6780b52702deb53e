"""Words of `mbd-ros report`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from mbd_ros.applications.report import items
from mbd_ros.errors import OK, DataError
from mbd_ros.jobs.arguments import add_allow_code
from mbd_ros.jobs.progress import say_all
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.scene.schema.locate import path_word

_README = "put the headlines of -o DIR into this file, between its two marks; nothing is run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `report` understands."""
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="default: all of this package")
    parser.add_argument("--quick", action="store_true", help="a small part, in two minutes")
    folder, text = Path("report_out"), "folder of the report (default: %(default)s)"
    parser.add_argument("-o", "--out", type=path_word, default=folder, metavar="DIR", help=text)
    parser.add_argument(
        "--only", nargs="+", choices=list(items.PARTS), metavar="KIND", help=", ".join(items.PARTS)
    )
    add_workers(parser)
    parser.add_argument("--readme", type=path_word, metavar="FILE", help=_README)
    add_allow_code(parser)


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    say_all(_lines(arguments))
    return OK


def _lines(arguments: argparse.Namespace) -> Iterator[str]:
    if arguments.readme is not None:
        from mbd_ros.applications.report.page import put_headlines

        if arguments.scenes or arguments.quick or arguments.only:
            raise DataError("--readme takes the numbers of -o DIR as they are")
        return put_headlines(arguments.readme, arguments.out)
    from mbd_ros.applications.report.compose import Order, report

    return report(
        Order(
            **{
                name: getattr(arguments, name) or default
                for name, default in Order._field_defaults.items()
            }
        )
    )

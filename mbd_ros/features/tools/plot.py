"""The command `mbd-ros plot`: a picture of a result."""

import argparse

from mbd_ros.errors import OK, DataError
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `plot`."""
    from mbd_ros.files.table import MAIN

    parser.add_argument(
        "result", type=path_word, help="CSV (.gz), .npz, .parquet, .mot, .sto, .trc, .c3d or bag."
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="Picture: .png, .svg or .pdf (required).",
    )
    parser.add_argument(
        "--columns",
        nargs="+",
        help="Names of columns, or the ends of names, such as effort. By default positions, "
        "velocities, efforts and multipliers are drawn.",
    )
    parser.add_argument(
        "--power-flow",
        action="store_true",
        help="Draw the power that flows from segment to segment, from a result of "
        "`mbd-ros inverse --power`.",
    )
    parser.add_argument(
        "--table", default=MAIN, help="Table of the result that is drawn (default: %(default)s)."
    )


def run(arguments: argparse.Namespace) -> int:
    """Draw the picture and return the exit code."""
    from mbd_ros.files.formats import PICTURES
    from mbd_ros.files.table import read_result
    from mbd_ros.files.text_file import refuse_overwriting

    refuse_overwriting(arguments.out, arguments.result)
    result = read_result(arguments.result)
    if arguments.power_flow:
        from mbd_ros.files.plot import save
        from mbd_ros.files.power_flow import power_flow

        if arguments.columns is not None:
            raise DataError("--power-flow and --columns: accepted is one of the two")
        save(power_flow(result, arguments.table), arguments.out)
    else:
        options = {"table": arguments.table, "columns": arguments.columns}
        with about(arguments.result):
            result.to(arguments.out, among=PICTURES, **options)
    say(f"{result[arguments.table].rows} rows -> {arguments.out}")
    return OK

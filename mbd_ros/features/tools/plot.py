"""Words of `mbd-ros plot`."""

import argparse

from mbd_ros.errors import OK, DataError
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `plot` understands."""
    parser.add_argument(
        "result", type=path_word, help="CSV (.gz), .npz, .parquet, .mot, .sto, .trc, .c3d or bag"
    )
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help=".png, .svg or .pdf (required)"
    )
    parser.add_argument(
        "--columns",
        nargs="+",
        help="names, or last words of names: effort (default: positions, velocities, efforts and "
        "multipliers)",
    )
    parser.add_argument(
        "--power-flow",
        action="store_true",
        help="bands of the power from segment to segment, of a result of inverse --power",
    )
    parser.add_argument(
        "--table", default="samples", help="table of the result (default: %(default)s)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.files.formats import PICTURES
    from mbd_ros.files.table import read_result
    from mbd_ros.files.text_file import refuse_overwriting

    refuse_overwriting(arguments.out, arguments.result)
    result = read_result(arguments.result)
    if arguments.power_flow:
        from mbd_ros.files.plot import save
        from mbd_ros.files.power_flow import power_flow

        if arguments.columns is not None:
            raise DataError("--power-flow chooses its columns; accepted: it or --columns")
        save(power_flow(result, arguments.table), arguments.out)
    else:
        options = {"table": arguments.table, "columns": arguments.columns}
        with about(arguments.result):
            result.to(arguments.out, among=PICTURES, **options)
    say(f"{result[arguments.table].rows} rows -> {arguments.out}")
    return OK

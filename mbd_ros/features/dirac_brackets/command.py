"""The command `mbd-ros bracket`: Dirac brackets of a scene with constraints."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_option
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word

_JOB = "mbd_ros.features.dirac_brackets.job:bracket"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `bracket`."""
    add_scene(parser)
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        help="Table of the brackets; .npz and .parquet also hold checks.",
    )
    add_option(parser, _JOB, "symbolic", default=None, action="store_true")


def run(arguments: argparse.Namespace) -> int:
    """Compute the brackets, write them and return the exit code."""
    from mbd_ros.features.dirac_brackets.job import bracket
    from mbd_ros.files.formats import format_of
    from mbd_ros.files.table import MAIN, Result
    from mbd_ros.files.text_file import check_place, refuse_overwriting
    from mbd_ros.scene.reader import load_any

    out, scene = arguments.out, load_any(arguments.scene)
    if out is not None:
        refuse_overwriting(out, scene.path)
        check_place(out)
    result = bracket(scene, symbolic=arguments.symbolic, say=say)
    if out is not None:
        if format_of(out).one_table:
            result = Result({MAIN: result[MAIN]}, result.metadata)
        result.to(out)
        say(f"{', '.join(result)} -> {out}")
    return OK

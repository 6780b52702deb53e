"""Command line of `mbd-ros payload`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_option, add_options
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word

_JOB = "mbd_ros.features.identification.payload.job:payload"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `payload` to a parser."""
    add_scene(parser)
    add_option(parser, _JOB, "motion", "motion")
    add_options(parser, _JOB, "without", "frame", "wrenches", "topic", "derivatives", "band")
    form = {"type": str, "nargs": "+", "default": (), "metavar": "JOINT=VALUE"}
    add_option(parser, _JOB, "gains", "--gain", dest="gain", **form)
    add_option(parser, _JOB, "partial")
    parser.add_argument(
        "-o", "--out", type=path_word, help="Table of the result, as .csv, .npz or .parquet."
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from mbd_ros.features.identification.command import parse_gains
    from mbd_ros.features.identification.payload.job import payload
    from mbd_ros.files.text_file import check_place, refuse_overwriting
    from mbd_ros.scene.reader import load_scene

    if arguments.out is not None:
        refuse_overwriting(arguments.out, arguments.motion, arguments.without, arguments.wrenches)
        check_place(arguments.out)
    names = ("frame", "without", "wrenches", "topic", "derivatives", "band", "partial")
    options = {name: getattr(arguments, name) for name in names}
    gains = parse_gains(arguments.gain)
    scene = load_scene(arguments.scene)
    result = payload(scene, arguments.motion, **options, gains=gains, say=say, progress=True)
    if arguments.out is not None:
        result.table().to(arguments.out)
        say(f"-> {arguments.out}")
    return OK

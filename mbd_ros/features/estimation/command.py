"""Command line of `mbd-ros estimate`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_option
from mbd_ros.jobs.progress import say
from mbd_ros.motion.options import add_topic, add_wrenches
from mbd_ros.scene.schema.locate import path_word

_TASK = "mbd_ros.features.estimation.task:EstimateTask"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `estimate` to a parser."""
    add_scene(parser)
    parser.add_argument(
        "motion", type=path_word, help="Recording of some joints: a table or a bag."
    )
    parser.add_argument(
        "task", type=path_word, nargs="?", help="Task file with a section estimate."
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="Estimated motion: CSV, bag, .. (required).",
    )
    parser.add_argument(
        "--innovations", type=path_word, help="Also write measurements minus predictions."
    )
    add_wrenches(parser)
    add_option(parser, _TASK, "inputs", only_given=True)
    add_topic(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from mbd_ros.features.estimation.job import NO_TASK, estimate_to
    from mbd_ros.scene.reader import load_scene

    options = {} if arguments.inputs is None else {"inputs": arguments.inputs}
    estimate_to(
        load_scene(arguments.scene),
        arguments.motion,
        arguments.out,
        arguments.innovations,
        say,
        task=arguments.task or NO_TASK,
        topic=arguments.topic,
        wrenches=arguments.wrenches,
        **options,
    )
    return OK

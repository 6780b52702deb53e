"""Command line of `mbd-ros estimate`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `estimate` to a parser."""
    add_scene(parser)
    parser.add_argument(
        "motion", type=path_word, help="recording of some joints: a table or a bag"
    )
    parser.add_argument(
        "task", type=path_word, nargs="?", help="task file with a section estimate"
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="estimated motion: CSV, bag, .. (required)",
    )
    parser.add_argument(
        "--innovations", type=path_word, help="also write measurements minus predictions"
    )
    parser.add_argument(
        "--wrenches", type=path_word, help="table or bag of the external loads of the scene"
    )
    parser.add_argument(
        "--inputs",
        choices=("efforts", "commands", "none"),
        help="source of the inputs that move the mechanism (default: efforts)",
    )
    parser.add_argument(
        "--topic",
        default="/joint_states",
        help="JointState topic of a bag (default: %(default)s)",
    )


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

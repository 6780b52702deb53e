"""Command line of `mbd-ros predict`."""

import argparse

from mbd_ros.errors import FAILED, OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `predict` to a parser."""
    add_scene(parser)
    parser.add_argument("task", type=path_word, help="Task file with a section predict.")
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        help="Predicted motion; .npz and .parquet hold all tables, .csv comes with OUT.goals.csv "
        "and OUT.nodes.csv.",
    )
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from mbd_ros.features.prediction.job import predict_to
    from mbd_ros.scene.reader import load_scene

    scene = load_scene(arguments.scene)

    workers = arguments.workers, arguments.scheduler
    has_solution = predict_to(scene, arguments.task, arguments.out, say, *workers)
    return OK if has_solution else FAILED

"""Command line of `mbd-ros gait`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gait` to a parser."""
    add_scene(parser)
    parser.add_argument(
        "task",
        type=path_word,
        nargs="?",
        help="Task file with a section gait. By default the search starts at the start of the "
        "scene.",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        help="Motion of the first gait; .npz and .parquet hold all tables, a .csv comes with "
        "OUT.gaits.csv, OUT.branches.csv and OUT.basin.csv.",
    )
    parser.add_argument("--page", type=path_word, help="HTML page with tables and pictures.")
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from mbd_ros.features.gait.job import gait_to
    from mbd_ros.scene.reader import load_scene

    workers = arguments.workers, arguments.scheduler
    scene = load_scene(arguments.scene)
    gait_to(scene, arguments.task, arguments.out, arguments.page, say, *workers)
    return OK

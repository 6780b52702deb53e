"""Words of `mbd-ros gait`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `gait` understands."""
    add_scene(parser)
    parser.add_argument(
        "task",
        type=path_word,
        nargs="?",
        help="task file with a section gait (default: a gait near the start of the scene)",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        help="motion of the first gait; .npz and .parquet hold all tables, beside a .csv stand "
        "OUT.gaits.csv, OUT.branches.csv and OUT.basin.csv",
    )
    parser.add_argument("--page", type=path_word, help="a page with tables and pictures: .html")
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.gait.job import gait_to
    from mbd_ros.scene.reader import load_scene

    where = arguments.workers, arguments.scheduler
    scene = load_scene(arguments.scene)
    gait_to(scene, arguments.task, arguments.out, arguments.page, say, *where)
    return OK

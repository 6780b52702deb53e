"""Words of `mbd-ros predict`."""

import argparse

from mbd_ros.errors import FAILED, OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `predict` understands."""
    add_scene(parser)
    parser.add_argument("task", type=path_word, help="task file with a section predict")
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        help="the motion; .npz and .parquet hold all tables, beside a .csv stand OUT.goals.csv "
        "and OUT.nodes.csv",
    )
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.prediction.job import predict_to
    from mbd_ros.scene.reader import load_scene

    scene = load_scene(arguments.scene)
    where = arguments.workers, arguments.scheduler
    is_found = predict_to(scene, arguments.task, arguments.out, say, *where)
    return OK if is_found else FAILED

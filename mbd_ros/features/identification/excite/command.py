"""Words of `mbd-ros excite`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `excite` understands."""
    add_scene(parser)
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help="folder for the trajectory (required)"
    )
    options = (
        ("--period", float, 10.0, "of the motion in s, which may be repeated"),
        ("--harmonics", int, 5, "of the motion"),
        ("--share", float, 0.9, "of limits of position, velocity and effort that is used"),
        ("--rate", float, 50.0, "points of the trajectory a second"),
        ("--evaluations", int, 2000, "motions that are tried"),
        ("--seed", int, 0, "of the random numbers"),
    )
    for name, kind, default, text in options:
        parser.add_argument(name, type=kind, default=default, help=f"{text} (default: {default})")


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.identification.excite.trajectory_files import excite_to
    from mbd_ros.scene.reader import load_scene

    names = ("period", "harmonics", "share", "evaluations", "seed")
    options = {name: getattr(arguments, name) for name in names}
    excite_to(load_scene(arguments.scene), arguments.out, arguments.rate, options, say)
    return OK

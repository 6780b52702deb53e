"""Command line of `mbd-ros excite`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `excite` to a parser."""
    add_scene(parser)
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help="folder for the trajectory (required)"
    )
    options = (
        ("--period", float, 10.0, "period of the motion in s; the motion can be repeated"),
        ("--harmonics", int, 5, "harmonics of the motion"),
        (
            "--share",
            float,
            0.9,
            "share of the limits of position, velocity and effort that is used",
        ),
        ("--rate", float, 50.0, "points of the trajectory per second"),
        ("--evaluations", int, 2000, "motions that are compared"),
        ("--seed", int, 0, "seed of the random numbers"),
    )
    for name, kind, default, text in options:
        parser.add_argument(name, type=kind, default=default, help=f"{text} (default: {default})")


def run(arguments: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from mbd_ros.features.identification.excite.trajectory_files import excite_to
    from mbd_ros.scene.reader import load_scene

    names = ("period", "harmonics", "share", "evaluations", "seed")
    options = {name: getattr(arguments, name) for name in names}
    excite_to(load_scene(arguments.scene), arguments.out, arguments.rate, options, say)
    return OK

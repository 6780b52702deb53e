"""Words of `mbd-ros replay`."""

import argparse

from mbd_ros.errors import FAILED, OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `replay` understands."""
    parser.add_argument("bag", type=path_word)
    add_scene(parser)
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help="bag of the node's output (required)"
    )
    parser.add_argument("--rate", type=float, default=1.0, help="speed factor (default: 1)")
    parser.add_argument("--reference", help="JointState topic to compare with; else the effort")
    parser.add_argument(
        "--skip",
        type=float,
        default=0.5,
        help="seconds left out of the errors at the start (default: %(default)s)",
    )
    parser.add_argument(
        "--cutoff",
        type=float,
        default=5.0,
        help="of the filters that estimate derivatives, Hz (default: %(default)s)",
    )
    parser.add_argument(
        "--topic",
        default="/joint_states",
        help="JointState topic of the bag (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.replay.job import Replay, replay

    names = ("bag", "scene", "out", "rate", "topic", "cutoff")
    asked = Replay(**{name: getattr(arguments, name) for name in names})
    found = replay(asked, arguments.reference, arguments.skip, say)
    return OK if found.metadata["answered"] == found.metadata["played"] else FAILED

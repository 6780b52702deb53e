"""Command line of `mbd-ros payload`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `payload` to a parser."""
    add_scene(parser)
    parser.add_argument("motion", type=path_word, help="table or bag with positions and efforts")
    parser.add_argument(
        "--without",
        type=path_word,
        help="recording of the robot without the payload, from which the robot is identified "
        "first (default: the scene is right)",
    )
    parser.add_argument("--frame", help="link that carries the payload (default: the last link)")
    parser.add_argument(
        "--wrenches", type=path_word, help="table of the external loads in the scene"
    )
    parser.add_argument(
        "--topic",
        default="/joint_states",
        help="JointState topic of bags (default: %(default)s)",
    )
    parser.add_argument(
        "--derivatives",
        choices=("given", "zero-phase"),
        help="where velocities and accelerations come from (default: given where a motion has "
        "accelerations, else zero-phase)",
    )
    parser.add_argument("--band", type=float, help="end of the frequency band of the fit in Hz")
    parser.add_argument(
        "--gain",
        nargs="+",
        default=(),
        metavar="JOINT=VALUE",
        help="torque for a unit of effort",
    )
    parser.add_argument(
        "--partial", action="store_true", help="accept a motion that hides some numbers"
    )
    parser.add_argument(
        "-o", "--out", type=path_word, help="table of the result, as .csv, .npz or .parquet"
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

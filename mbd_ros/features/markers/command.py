"""Words of `mbd-ros kinematics`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `kinematics` understands."""
    add_scene(parser)
    parser.add_argument("markers", type=path_word, help="recorded markers: .trc, .c3d, .csv, ..")
    parser.add_argument(
        "task",
        type=path_word,
        nargs="?",
        help="task file with a section kinematics, or a set-up of OpenSim's inverse kinematics",
    )
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help="motion: .mot, CSV, .. (required)"
    )
    parser.add_argument(
        "--residuals", type=path_word, help="also write objective and distances of markers"
    )
    parser.add_argument("--begin", type=float, help="first time in s (default: of the task)")
    parser.add_argument("--end", type=float, help="last time in s (default: of the task)")
    parser.add_argument(
        "--unit", choices=("m", "mm", "cm"), help="of the markers (default: of the file)"
    )
    parser.add_argument(
        "--axes",
        help="recorded axis along each axis of the scene, as x,z,-y, or screen: as the .c3d says "
        "by X_SCREEN, Y_SCREEN (default: x,y,z)",
    )
    parser.add_argument(
        "--smoothness",
        type=float,
        help="error of markers over error of accelerations in m s^2/rad: fits the whole trial",
    )
    parser.add_argument(
        "--no-limits", action="store_true", help="joints may pass the limits of the description"
    )


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.markers.job import kinematics_to
    from mbd_ros.features.markers.marker_kinematics import NO_TASK
    from mbd_ros.scene.reader import load_scene

    names = ("begin", "end", "unit", "axes", "smoothness")
    options = {name: getattr(arguments, name) for name in names}
    if arguments.no_limits:
        options["limits"] = False
    kinematics_to(
        load_scene(arguments.scene),
        arguments.markers,
        arguments.out,
        arguments.residuals,
        say,
        task=arguments.task or NO_TASK,
        **options,
    )
    return OK

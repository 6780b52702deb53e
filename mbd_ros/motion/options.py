"""Options of every command that reads a recorded motion."""

import argparse
from typing import Any

from mbd_ros.jobs.options import add_option
from mbd_ros.scene.schema.locate import path_word

MOTION = "Motion: CSV (.gz), .npz, .parquet, .mot, .sto, rosbag2 folder, .mcap or .db3."
_TASK = "mbd_ros.motion.samples:Task"
_DERIVATIVES = "mbd_ros.motion.derivatives:Derivatives"
_STANCE = "mbd_ros.motion.stance:StanceTask"
_STANCE_THRESHOLDS = "mbd_ros.methods.inverse_dynamics.stance:StanceThresholds"


def add_motions(parser: argparse.ArgumentParser) -> None:
    """Declare the motions, their loads, and the place of the results."""
    parser.add_argument("motion", type=path_word, nargs="+", help=MOTION)
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="CSV (.gz), .npz, .parquet, .sto or bag for the result; a folder for the results of "
        "several motions (required).",
    )
    add_wrenches(parser)
    add_external(
        parser,
        nargs="+",
        default=(),
        help="external loads of OpenSim (.xml with its .mot), in place of those of the scene; one "
        "for all motions, or one for each",
    )
    add_topic(parser)


def add_wrenches(parser: argparse.ArgumentParser) -> None:
    """Declare the recording of the external loads."""
    add_option(parser, _TASK, "wrenches")


def add_external(parser: argparse.ArgumentParser, **changes: Any) -> None:
    """Declare the file of OpenSim with external loads."""
    add_option(parser, _TASK, "external", **changes)


def add_topic(parser: argparse.ArgumentParser) -> None:
    """Declare the topic of a bag that holds the motion."""
    add_option(parser, _TASK, "topic")


def add_bounds(parser: argparse.ArgumentParser) -> None:
    """Declare the option that keeps efforts within their limits."""
    add_option(parser, _TASK, "bounds")


def add_torque_parts(parser: argparse.ArgumentParser) -> None:
    """Declare the options that ask for torques by cause and for powers."""
    add_option(parser, _TASK, "parts")
    add_option(parser, _TASK, "power")


def add_time_range(parser: argparse.ArgumentParser) -> None:
    """Declare the part of a motion that is solved."""
    add_option(parser, _TASK, "time_range", nargs=2, metavar=("FIRST", "LAST"))


def add_wrench_axes(parser: argparse.ArgumentParser) -> None:
    """Declare the axes of a laboratory that are not those of the scene."""
    add_option(parser, _TASK, "wrench_axes")


def add_derivatives(parser: argparse.ArgumentParser) -> None:
    """Declare the source of velocities and accelerations."""
    add_option(parser, _DERIVATIVES, "source", "--derivatives", dest="derivatives")
    add_option(parser, _DERIVATIVES, "cutoff")
    add_option(parser, _DERIVATIVES, "half_width")


def add_stance(parser: argparse.ArgumentParser) -> None:
    """Declare the options for feet on the ground without a force plate."""
    add_option(parser, _STANCE, "method", "--stance", dest="stance", default=None)
    for name in ("gap", "speed"):
        flag, dest = f"--stance-{name}", f"stance_{name}"
        add_option(parser, _STANCE_THRESHOLDS, name, flag, dest=dest, only_given=True)

"""Options of every command that reads a recorded motion."""

import argparse

from mbd_ros.scene.schema.locate import path_word


def add_stance(parser: argparse.ArgumentParser) -> None:
    """Feet on the ground without a force plate."""
    parser.add_argument(
        "--stance",
        choices=("minimum-norm", "smooth"),
        help="forces of contacts that nobody measured are unknowns; where the motion leaves them "
        "open: the least efforts, or the smooth transition of walking between two feet",
    )
    parser.add_argument(
        "--stance-gap",
        type=float,
        help="largest gap on the ground, as a multiple of the size (default: 0.001)",
    )
    parser.add_argument(
        "--stance-speed",
        type=float,
        help="largest speed along the normal on the ground, of sqrt(g size) (default: 0.02)",
    )


def add_motions(parser: argparse.ArgumentParser) -> None:
    """Motions, their loads, and where results go."""
    parser.add_argument(
        "motion",
        type=path_word,
        nargs="+",
        help="CSV (.gz), .npz, .parquet, .mot, .sto, rosbag2 folder, .mcap or .db3",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="CSV (.gz), .npz, .parquet, .sto or bag; of several motions a folder (required)",
    )
    parser.add_argument(
        "--wrenches",
        type=path_word,
        help="CSV or bag of the loads in the scene; a bag motion carries its own",
    )
    parser.add_argument(
        "--external",
        type=path_word,
        nargs="+",
        default=(),
        help="external loads of OpenSim (.xml with its .mot), in place of those of the scene; one "
        "for all motions, or one for each",
    )
    parser.add_argument(
        "--topic",
        default="/joint_states",
        help="JointState topic of a bag (default: %(default)s)",
    )


def add_time_range(parser: argparse.ArgumentParser) -> None:
    """Which part of a motion is solved."""
    parser.add_argument(
        "--time-range",
        type=float,
        nargs=2,
        metavar=("FIRST", "LAST"),
        help="solve these times alone [s]; derivatives come from the whole motion",
    )


def add_wrench_axes(parser: argparse.ArgumentParser) -> None:
    """Axes of a laboratory that are not those of the scene."""
    parser.add_argument(
        "--wrench-axes",
        help="recorded axis along each axis of the scene, as x,z,-y, or screen: as the .c3d says "
        "by X_SCREEN, Y_SCREEN; turns --wrenches (default: x,y,z)",
    )


def add_derivatives(parser: argparse.ArgumentParser) -> None:
    """Where velocities and accelerations come from."""
    parser.add_argument(
        "--derivatives",
        choices=("given", "causal", "zero-phase", "opensim"),
        default="given",
        help="given: the motion has them; causal: filtered, lagging, as the node does; "
        "zero-phase: low-pass that sees the future; opensim: its filter and splines, also where "
        "a .mot has positions alone (default: %(default)s)",
    )
    parser.add_argument(
        "--cutoff",
        type=float,
        help="half-power frequency of the filters in Hz (default: causal 5.0, zero-phase from the "
        "noise of the recording, and printed; opensim 6, inf for no filter)",
    )
    parser.add_argument(
        "--half-width",
        type=int,
        help="zero-phase only, in place of a cut-off: fits to so many samples on either side",
    )

"""Command line of `mbd-ros identify`."""

import argparse
from collections.abc import Sequence

from mbd_ros.errors import OK, DataError
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `identify` to a parser."""
    add_scene(parser)
    add_recordings(parser)
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help="folder for the result (required)"
    )
    parser.add_argument(
        "--learned",
        type=float,
        default=0.6,
        help="share of the time of each recording that is for the fit; the rest is for the test "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--held",
        type=path_word,
        nargs="+",
        default=(),
        help="recordings of the robot with a known load; --payload describes the load",
    )
    parser.add_argument(
        "--payload",
        metavar="LINK=MASS,CX,CY,CZ[,IXX,IYY,IZZ]",
        help="load of --held: mass in kg, and centre in m and moments about it in the axes of a "
        "link",
    )
    parser.add_argument(
        "--known", nargs="+", default=(), metavar="LINK", help="links whose inertia is right"
    )
    parser.add_argument(
        "--currents",
        action="store_true",
        help="efforts are in other units, such as motor currents; gains are estimated from a "
        "known load, link or force",
    )
    parser.add_argument(
        "--partial",
        action="store_true",
        help="accept a motion that hides some parameters; these keep their values",
    )


def add_recordings(parser: argparse.ArgumentParser) -> None:
    """Add options about the recordings and their processing."""
    parser.add_argument(
        "motion", type=path_word, nargs="+", help="tables or bags with positions and efforts"
    )
    parser.add_argument(
        "--wrenches",
        type=path_word,
        nargs="+",
        default=(),
        help="tables of the external loads, one per motion; a bag contains its own",
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
    add_physics(parser)


def add_physics(parser: argparse.ArgumentParser) -> None:
    """Add options about the unknowns and about what is known."""
    parser.add_argument(
        "--band",
        type=float,
        help="end of the frequency band of the fit in Hz (default: from the motion, and printed)",
    )
    parser.add_argument(
        "--friction",
        nargs="+",
        default=["auto"],
        metavar="TERM",
        help="auto, none, or of viscous coulomb offset load stribeck inertia (default: auto)",
    )
    parser.add_argument(
        "--gain",
        nargs="+",
        default=(),
        metavar="JOINT=VALUE",
        help="torque for a unit of effort, such as a motor constant behind a gear in N·m/A",
    )
    parser.add_argument(
        "--passive",
        nargs="+",
        default=(),
        metavar="JOINT",
        help="joints without a motor (default: where nothing is measured but wrenches, those that "
        "place the first body)",
    )
    parser.add_argument(
        "--delay", type=float, help="delay of efforts against motion in s (default: estimated)"
    )


def parse_payload(argument: str | None) -> tuple[str, list[float]] | None:
    """Parse --payload: return link and numbers of a load, or None without one.

    Raises:
        DataError: The text is not LINK=MASS,CX,CY,CZ[,IXX,IYY,IZZ], or not positive.
    """
    if argument is None:
        return None
    link, _, numbers = argument.rpartition("=")
    try:
        values = [float(number) for number in numbers.split(",")]
    except ValueError:
        values = []
    is_valid = len(values) in (4, 7) and all(abs(x) < float("inf") for x in values)
    if not link or not is_valid or min([values[0], *values[4:]]) <= 0.0:
        raise DataError(
            f"--payload {argument}: expected LINK=MASS,CX,CY,CZ or "
            "LINK=MASS,CX,CY,CZ,IXX,IYY,IZZ, with mass and moments > 0"
        )
    return link, values


def parse_gains(arguments: Sequence[str]) -> dict[str, float]:
    """Parse --gain: return joint -> torque for a unit of effort.

    Raises:
        DataError: An argument is not JOINT=VALUE.
    """
    gains = {}
    for argument in arguments:
        name, _, value = argument.rpartition("=")
        try:
            gains[name] = float(value)
        except ValueError:
            gains[name] = float("nan")
        if not name or not abs(gains[name]) < float("inf"):
            raise DataError(f"--gain {argument}: expected JOINT=VALUE, such as wrist=12.5")
    return gains


def run(arguments: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from mbd_ros.features.identification.job import identify_to
    from mbd_ros.features.identification.task import Task
    from mbd_ros.scene.reader import load_scene

    task = Task(
        arguments.motion,
        arguments.wrenches,
        arguments.topic,
        arguments.derivatives,
        arguments.band,
        arguments.friction,
        parse_gains(arguments.gain),
        arguments.passive,
        arguments.learned,
        arguments.delay,
        arguments.partial,
        arguments.held,
        parse_payload(arguments.payload),
        arguments.known,
        arguments.currents,
    )
    identify_to(load_scene(arguments.scene), task, arguments.out, say)
    return OK

"""Words of `mbd-ros identify`."""

import argparse
from collections.abc import Sequence

from mbd_ros.errors import OK, DataError
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `identify` understands."""
    add_scene(parser)
    add_recordings(parser)
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help="folder for the result (required)"
    )
    parser.add_argument(
        "--learned",
        type=float,
        default=0.6,
        help="share of the time of each recording that is learned from; the rest is for the test "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--held",
        type=path_word,
        nargs="+",
        default=(),
        help="recordings with a known load, see --payload",
    )
    parser.add_argument(
        "--payload",
        metavar="LINK=MASS,CX,CY,CZ[,IXX,IYY,IZZ]",
        help="what --held holds: mass in kg, centre in m and moments about it in the axes of a "
        "link",
    )
    parser.add_argument(
        "--known", nargs="+", default=(), metavar="LINK", help="links whose inertia is right"
    )
    parser.add_argument(
        "--currents",
        action="store_true",
        help="efforts are in other units, such as motor currents: their gains are estimated, "
        "which a known load or link has to fix",
    )
    parser.add_argument(
        "--partial",
        action="store_true",
        help="go on with a motion that does not show everything; what it hides stays as given",
    )


def add_recordings(parser: argparse.ArgumentParser) -> None:
    """Recordings, and how they are looked at."""
    parser.add_argument(
        "motion", type=path_word, nargs="+", help="tables or bags with positions and efforts"
    )
    parser.add_argument(
        "--wrenches",
        type=path_word,
        nargs="+",
        default=(),
        help="tables of the loads in the scene, one a motion; a bag carries its own",
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
    """What is looked for, and what is known."""
    parser.add_argument(
        "--band",
        type=float,
        help="end of the band that is looked at in Hz (default: from the motion, and printed)",
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
        "--delay", type=float, help="of efforts against motion in s (default: estimated)"
    )


def payload_of(word: str | None) -> tuple[str, list[float]] | None:
    """Link and numbers of a load; None without one.

    Raises:
        DataError: They are not.
    """
    if word is None:
        return None
    link, _, numbers = word.rpartition("=")
    try:
        found = [float(number) for number in numbers.split(",")]
    except ValueError:
        found = []
    is_right = len(found) in (4, 7) and all(abs(x) < float("inf") for x in found)
    if not link or not is_right or min([found[0], *found[4:]]) <= 0.0:
        raise DataError(
            f"--payload {word}: expected LINK=MASS,CX,CY,CZ or LINK=MASS,CX,CY,CZ,IXX,IYY,IZZ, "
            "mass and moments > 0"
        )
    return link, found


def gains_of(words: Sequence[str]) -> dict[str, float]:
    """Joint -> torque for a unit of effort.

    Raises:
        DataError: A word is not JOINT=VALUE.
    """
    gains = {}
    for word in words:
        name, _, value = word.rpartition("=")
        try:
            gains[name] = float(value)
        except ValueError:
            gains[name] = float("nan")
        if not name or not abs(gains[name]) < float("inf"):
            raise DataError(f"--gain {word}: expected JOINT=VALUE, as wrist=12.5")
    return gains


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
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
        gains_of(arguments.gain),
        arguments.passive,
        arguments.learned,
        arguments.delay,
        arguments.partial,
        arguments.held,
        payload_of(arguments.payload),
        arguments.known,
        arguments.currents,
    )
    identify_to(load_scene(arguments.scene), task, arguments.out, say)
    return OK

"""Command line of `mbd-ros identify`."""

import argparse
from collections.abc import Sequence

from mbd_ros.errors import OK, DataError
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_option, add_options
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word

_TASK = "mbd_ros.features.identification.task:Task"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `identify` to a parser."""
    add_scene(parser)
    add_recordings(parser)
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help="Folder for the result (required)."
    )
    add_option(parser, _TASK, "learned")
    add_option(parser, _TASK, "held")
    add_option(
        parser,
        _TASK,
        "payload",
        type=str,
        nargs=None,
        metavar="LINK=MASS,CX,CY,CZ[,IXX,IYY,IZZ]",
    )
    add_option(parser, _TASK, "known", metavar="LINK")
    add_options(parser, _TASK, "currents", "partial")


def add_recordings(parser: argparse.ArgumentParser) -> None:
    """Add options about the recordings and their processing."""
    add_option(parser, _TASK, "motions", "motion", type=path_word)
    add_options(parser, _TASK, "wrenches", "topic", "derivatives")
    add_physics(parser)


def add_physics(parser: argparse.ArgumentParser) -> None:
    """Add options about the unknowns and about what is known."""
    add_option(parser, _TASK, "band")
    add_option(parser, _TASK, "friction", metavar="TERM")
    form = {"type": str, "nargs": "+", "default": (), "metavar": "JOINT=VALUE"}
    add_option(parser, _TASK, "gains", "--gain", dest="gain", **form)
    add_option(parser, _TASK, "passive", metavar="JOINT")
    add_option(parser, _TASK, "delay")


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

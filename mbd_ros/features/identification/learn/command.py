"""Command line of `mbd-ros learn`."""

import argparse
from collections.abc import Collection, Sequence

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_option, add_options
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word

_TASK = "mbd_ros.features.identification.learn.task:Task"
_COMPARISON = "mbd_ros.features.identification.learn.comparison:compare_to"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `learn` to a parser."""
    add_scene(parser)
    parser.add_argument(
        "motion", type=path_word, nargs="*", help="Tables or bags with positions and efforts."
    )
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help="Folder for the model (required)."
    )
    add_options(parser, _TASK, "variant", "physics")
    add_option(parser, _TASK, "freeze", nargs="+", default=("physics",), metavar="WHAT")
    add_option(parser, _TASK, "start", type=path_word)
    parser.add_argument(
        "--compare", action="store_true", help="Compare five methods over growing training times."
    )
    _add_numbers(parser)


def _add_numbers(parser: argparse.ArgumentParser) -> None:
    """Add options about the processing of recordings and about the optimization."""
    add_options(parser, _TASK, "wrenches", "topic", "derivatives", "band", "learned")
    add_options(parser, _TASK, "members", "steps", "rate", "seed")
    add_option(parser, _COMPARISON, "seeds")


def _split_freeze(arguments: Sequence[str], accepted: Collection[str]) -> tuple[str, list[str]]:
    """Return the value of --freeze, and the motions that follow it on the command line."""
    for count in (1, 2):
        if " ".join(arguments[:count]) in accepted:
            return " ".join(arguments[:count]), list(arguments[count:])
    return " ".join(arguments), []


def run(arguments: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from mbd_ros.features.identification.learn.comparison import compare_to
    from mbd_ros.features.identification.learn.job import learn_to
    from mbd_ros.features.identification.learn.task import FREEZE, Task
    from mbd_ros.scene.reader import load_scene

    names = ("wrenches", "topic", "derivatives", "band", "learned", "variant", "physics")
    names += ("members", "steps", "seed", "rate")
    options = {name: getattr(arguments, name) for name in names}
    freeze, after = _split_freeze(arguments.freeze, FREEZE)
    motions = [*arguments.motion, *map(path_word, after)]
    task = Task(motions, freeze=freeze, **options)
    scene = load_scene(arguments.scene)
    if arguments.compare:
        compare_to(scene, task, arguments.out, say, seeds=arguments.seeds)
    else:
        learn_to(scene, task, arguments.out, arguments.start, say)
    return OK

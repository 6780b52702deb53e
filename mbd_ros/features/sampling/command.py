"""The command `mbd-ros sample`: samples of an ensemble, and mean forces."""

import argparse
from typing import Any

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_option, given_options
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.scene.schema.locate import path_word

_TASK = "mbd_ros.features.sampling.task:SampleTask"
_JOB = "mbd_ros.features.sampling.job:sample"
_NUMBERS = (
    *("temperature", "thermal_energy", "chains", "samples", "warmup", "steps"),
    *("dt", "friction", "seed"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `sample`."""
    add_scene(parser)
    parser.add_argument(
        "task",
        type=path_word,
        nargs="?",
        help="Task file whose section sample has the keys that are not given as options.",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        help="File for all samples. .npz and .parquet hold all tables; beside a .csv stand "
        "OUT.averages.csv, OUT.chains.csv, OUT.profile.csv and OUT.histogram.QUANTITY.csv.",
    )
    parser.add_argument(
        "--plot",
        type=path_word,
        help="Picture of the histograms or the profile: .png, .svg, .pdf.",
    )
    add_option(parser, _TASK, "method", only_given=True)
    for name in _NUMBERS:
        add_option(parser, _TASK, name, only_given=True, metavar="N")
    add_option(parser, _TASK, "fixman")
    parser.add_argument(
        "--random-starts",
        action="store_true",
        help="Start the chains at random configurations on the constraints.",
    )
    add_option(parser, _TASK, "kinetics")
    add_option(
        parser, _TASK, "observe", type=str, nargs=None, action="append", metavar="'distance A B'"
    )
    add_option(parser, _TASK, "coordinate", metavar="Q")
    add_option(parser, _TASK, "at", default=None, metavar="N")
    add_option(parser, _JOB, "checkpoint")
    add_option(parser, _JOB, "goes_on", "--continue", metavar="CHECKPOINT")
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    """Sample the ensemble, write the result and return the exit code."""
    from mbd_ros.features.sampling.job import Where, sample_to
    from mbd_ros.scene.reader import load_any

    where = Where(arguments.workers, arguments.scheduler, arguments.goes_on, arguments.checkpoint)
    scene = load_any(arguments.scene)
    sample_to(scene, arguments.task, _keys(arguments), arguments.out, arguments.plot, say, where)
    return OK


def _keys(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options that were given, as keys of the section `sample` of a task file."""
    keys = given_options(arguments, *_NUMBERS, "method", "coordinate", "at")
    keys |= {name: True for name in ("fixman", "kinetics") if getattr(arguments, name)}
    if arguments.random_starts:
        keys["starts"] = "random"
    if arguments.observe:
        keys["observe"] = {text.replace(" ", "_"): text for text in arguments.observe}
    return keys

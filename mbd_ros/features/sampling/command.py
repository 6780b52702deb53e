"""Words of `mbd-ros sample`."""

import argparse
from typing import Any

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.scene.schema.locate import path_word

_NUMBERS = (
    ("--temperature", float, "in K; in reduced units the thermal energy kT itself"),
    ("--thermal-energy", float, "kT in the unit of energy of the scene, in place of it"),
    ("--chains", int, "how many chains (default: 64)"),
    ("--samples", int, "samples a chain (default: 1000)"),
    ("--warmup", int, "samples a chain before them that are not kept (default: 200)"),
    ("--steps", int, "steps between samples (default: 5 of particles, 20 of mechanisms)"),
    ("--dt", float, "step (default: chosen)"),
    ("--friction", float, "rate at which langevin forgets velocities (default: chosen)"),
    ("--seed", int, "of the random numbers (default: 0)"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `sample` understands."""
    add_scene(parser)
    parser.add_argument(
        "task", type=path_word, nargs="?", help="task file with a section sample (default: none)"
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        help="all samples; .npz and .parquet hold all tables, beside a .csv stand "
        "OUT.averages.csv, OUT.chains.csv, OUT.profile.csv and OUT.histogram.QUANTITY.csv",
    )
    parser.add_argument("--plot", type=path_word, help="histograms or profile: .png, .svg or .pdf")
    parser.add_argument(
        "--method", choices=("metropolis", "langevin"), help="(default: metropolis)"
    )
    for name, kind, text in _NUMBERS:
        parser.add_argument(name, type=kind, metavar="N", help=text)
    parser.add_argument(
        "--fixman", action="store_true", help="rows are the limit of stiff springs"
    )
    parser.add_argument(
        "--random-starts", action="store_true", help="chains begin anywhere on the rows"
    )
    parser.add_argument(
        "--kinetics",
        action="store_true",
        help="shares of translation, rotation and the rest; the temperature that SHAKE shows",
    )
    parser.add_argument(
        "--observe", action="append", metavar="'distance A B'", help="a quantity that is kept"
    )
    parser.add_argument(
        "--coordinate", metavar="Q", help="quantity, row or joint along which to average"
    )
    parser.add_argument("--at", type=float, nargs="+", metavar="N", help="its values")
    parser.add_argument("--checkpoint", type=path_word, help="where chains stand at the end: .npz")
    parser.add_argument(
        "--continue", dest="goes_on", type=path_word, help="checkpoint of a run that goes on"
    )
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.sampling.job import Where, sample_to
    from mbd_ros.scene.reader import load_any

    where = Where(arguments.workers, arguments.scheduler, arguments.goes_on, arguments.checkpoint)
    scene = load_any(arguments.scene)
    sample_to(
        scene, arguments.task, _entries(arguments), arguments.out, arguments.plot, say, where
    )
    return OK


def _entries(arguments: argparse.Namespace) -> dict[str, Any]:
    """Entries of the section that words of the command replace."""
    names = [name.removeprefix("--").replace("-", "_") for name, *_ in _NUMBERS]
    found = {name: getattr(arguments, name) for name in (*names, "method", "coordinate", "at")}
    found |= {name: True for name in ("fixman", "kinetics") if getattr(arguments, name)}
    if arguments.random_starts:
        found["starts"] = "random"
    if arguments.observe:
        found["observe"] = {text.replace(" ", "_"): text for text in arguments.observe}
    return {name: value for name, value in found.items() if value is not None}

"""Words of `mbd-ros muscles`."""

import argparse
from pathlib import Path
from typing import Any

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.motion.options import (
    add_derivatives,
    add_motions,
    add_time_range,
    add_wrench_axes,
)
from mbd_ros.scene.schema.locate import path_word

_OPTIONS = (  # keys of the section `muscles` of a task file
    "objective",
    "exponent",
    "passive",
    "reserves",
    "rise",
    "fall",
    "emg",
    "emg_use",
    "emg_weight",
    "reactions",
    "links",
    "by_muscle",
    "dynamics",
    "interval",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `muscles` understands."""
    add_scene(parser)
    add_motions(parser)
    add_time_range(parser)
    add_wrench_axes(parser)
    add_derivatives(parser)
    _add_sharing(parser)
    _add_measured(parser)
    _add_loads(parser)
    _add_dynamics(parser)
    parser.add_argument(
        "--task", type=path_word, help="YAML whose section muscles says the same; options win"
    )
    add_workers(parser)


def _add_sharing(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--objective",
        choices=("activation", "stress", "volume", "metabolic"),
        help="what is least (default: activation)",
    )
    parser.add_argument(
        "--exponent",
        type=float,
        help="of activations, 1 .. 10 (default: activation and volume 2, stress 3, metabolic 1)",
    )
    parser.add_argument(
        "--passive",
        action="store_true",
        default=None,
        help="passive force of the fibres takes part (default: it is left out)",
    )
    parser.add_argument(
        "--reserves",
        help="optimal force of a reserve on every coordinate, or actuators of OpenSim (.xml) "
        "(default: none)",
    )
    parser.add_argument("--rise", type=float, help="fastest rise of an activation [1/s]")
    parser.add_argument("--fall", type=float, help="fastest fall of an activation [1/s]")


def _add_measured(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--emg", type=path_word, help="table with <muscle>.activation, 0 .. 1")
    parser.add_argument(
        "--emg-use",
        choices=("track", "least"),
        help="activations are near the measured ones, or not below them (default: track)",
    )
    parser.add_argument(
        "--emg-weight", type=float, help="of the squared distance from them (default: 10)"
    )


def _add_loads(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--reactions",
        choices=("child", "parent", "ground"),
        help="also loads of joints: on the child in its axes, on the parent in its axes, or on "
        "the child in world axes",
    )
    parser.add_argument("--links", help="links whose joint is asked for, a,b,c (default: all)")
    parser.add_argument(
        "--by-muscle", action="store_true", default=None, help="also the share of each muscle"
    )


def _add_dynamics(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--dynamics",
        choices=("activation", "tendon"),
        help="activations follow excitations over the whole motion; tendon: elastic tendons "
        "stretch, too (default: frames one by one)",
    )
    parser.add_argument(
        "--interval", type=float, help="longest interval of their mesh [s] (default: 0.02)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.muscles.job import muscles_batch
    from mbd_ros.motion.batch import batch_of

    muscles_batch(batch_of(arguments, _options(arguments)), arguments.task, say)
    return OK


def _options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Those that are given, as a task file has them."""
    given = {name: getattr(arguments, name) for name in _OPTIONS}
    given = {name: value for name, value in given.items() if value is not None}
    if "reserves" in given:
        given["reserves"] = _number_or_word(given["reserves"])
    if "links" in given:
        given["links"] = [name.strip() for name in given["links"].split(",")]
    for name in ("emg", "reserves"):
        if isinstance(given.get(name), str | Path):
            given[name] = str(Path(given[name]).absolute())
    return given


def _number_or_word(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text

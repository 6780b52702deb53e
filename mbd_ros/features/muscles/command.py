"""The command `mbd-ros muscles`: muscle forces and joint loads of recorded motions."""

import argparse
from pathlib import Path
from typing import Any

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_option, given_options
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.motion.options import (
    add_derivatives,
    add_motions,
    add_time_range,
    add_wrench_axes,
)
from mbd_ros.scene.schema.locate import path_word

_TASK = "mbd_ros.features.muscles.task:task_of_keys"
_SHARING = ("objective", "exponent", "passive", "reserves", "rise", "fall")
_MEASURED = ("emg", "emg_use", "emg_weight")
_LOADS = ("reactions", "links", "by_muscle")
_DYNAMICS = ("dynamics", "interval")
_OPTIONS = (*_SHARING, *_MEASURED, *_LOADS, *_DYNAMICS)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `muscles`."""
    add_scene(parser)
    add_motions(parser)
    add_time_range(parser)
    add_wrench_axes(parser)
    add_derivatives(parser)
    kinds = {"reserves": str, "emg": path_word, "links": str}
    for name in _OPTIONS:
        changes = {"type": kinds[name], "nargs": None} if name in kinds else {}
        add_option(parser, _TASK, name, only_given=True, **changes)
    parser.add_argument(
        "--task",
        type=path_word,
        help="Task file whose section muscles has the keys that are not given as options.",
    )
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    """Solve all motions and return the exit code."""
    from mbd_ros.features.muscles.job import muscles_batch
    from mbd_ros.motion.batch import batch_of

    muscles_batch(batch_of(arguments, _keys(arguments)), arguments.task, say)
    return OK


def _keys(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options that were given, as keys of the section `muscles` of a task file."""
    keys = given_options(arguments, *_OPTIONS)
    if "reserves" in keys:
        keys["reserves"] = _number_or_text(keys["reserves"])
    if "links" in keys:
        keys["links"] = [name.strip() for name in keys["links"].split(",")]
    for name in ("emg", "reserves"):
        if isinstance(keys.get(name), str | Path):
            keys[name] = str(Path(keys[name]).absolute())
    return keys


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text

"""The command `mbd-ros simulate`: motions from forces."""

import argparse
from typing import TYPE_CHECKING, Any

from mbd_ros.errors import OK, DataError
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_option
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.scene.schema.locate import path_word

if TYPE_CHECKING:
    from mbd_ros.features.simulation.run import Run
    from mbd_ros.scene.built_scene import Scene

_KEYS = "mbd_ros.features.simulation.task:task_of_keys"
_JOB = "mbd_ros.features.simulation.job:simulate"
_SCENE_OPTIONS = ("dt", "integrator", "tolerance", "solver")
_NOT_WITH_ENSEMBLE = ("start", "efforts", "wrenches", "events", "task")
_RUN_ARGUMENTS = ("origin", "start", "efforts", "wrenches")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `simulate`."""
    add_scene(parser)
    parser.add_argument(
        "-t", "--time", type=float, help="Simulated time [s]; required without --task."
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="CSV (.gz), .npz, .parquet or bag for the result (required).",
    )
    add_option(parser, _JOB, "integrator", type=str)
    add_option(parser, _JOB, "tolerance")
    add_option(parser, _KEYS, "dt")
    add_option(parser, _JOB, "solver", type=str)
    parser.add_argument(
        "--compiled", action="store_true", help="Run steps in native code: --solver compiled."
    )
    add_option(parser, _KEYS, "from_", "--from", dest="origin", type=path_word)
    add_option(parser, _KEYS, "start", only_given=True)
    add_option(parser, _KEYS, "efforts", type=path_word)
    add_option(parser, _KEYS, "wrenches", type=path_word)
    parser.add_argument(
        "--ensemble",
        type=path_word,
        help="CSV with one run in each row: initial states <joint>.position and .velocity, and "
        "numbers of parts <part>.<argument>. All runs go into one table.",
    )
    add_workers(parser)
    parser.add_argument(
        "--events", type=path_word, help="File for the table of events alone, as for --out."
    )
    parser.add_argument(
        "--task",
        type=path_word,
        help="Task file whose section simulate has the keys that are not given as options.",
    )


def run(arguments: argparse.Namespace) -> int:
    """Simulate, write the result and return the exit code."""
    from mbd_ros.features.simulation.job import simulate_to
    from mbd_ros.scene.reader import is_of_particles, load_any

    scene = load_any(arguments.scene)
    if is_of_particles(scene):
        from mbd_ros.features.simulation import particles

        return particles.run(scene, arguments)
    if arguments.ensemble is not None:
        return _run_ensemble(scene, arguments)
    for name in ("workers", "scheduler"):
        if getattr(arguments, name) is not None:
            raise DataError(f"--{name}: goes with --ensemble")
    simulate_to(scene, _order(scene, arguments), arguments.out, say, arguments.events)
    return OK


def _run_ensemble(scene: "Scene", arguments: argparse.Namespace) -> int:
    """Simulate many runs into one table and return the exit code."""
    from mbd_ros.features.simulation.ensemble import ensemble_to

    for name, option in (("origin", "from"), *((n, n) for n in _NOT_WITH_ENSEMBLE)):
        if getattr(arguments, name) is not None:
            raise DataError(f"--{option}: does not go with --ensemble")
    order = _order(scene, arguments)
    workers = arguments.workers, arguments.scheduler
    ensemble_to(scene, order, arguments.ensemble, arguments.out, say, *workers)
    return OK


def _order(scene: "Scene", arguments: argparse.Namespace) -> "Run":
    """Return the order of the options, with the keys of the task file that they leave out.

    Raises:
        MbdError: The file cannot be used, or the duration is missing.
    """
    from mbd_ros.features.simulation.run import Run, options_of

    order: dict[str, Any] = {"duration": arguments.time}
    order |= {name: getattr(arguments, name) for name in _RUN_ARGUMENTS}
    order = {name: value for name, value in order.items() if value is not None}
    options = {name: getattr(arguments, name) for name in _SCENE_OPTIONS}
    if arguments.compiled:
        if options["solver"] not in (None, "compiled"):
            raise DataError(
                f"--compiled and --solver {options['solver']}: accepted is one of the two"
            )
        options["solver"] = "compiled"
    task_options: dict[str, Any] = {}
    if arguments.task is not None:
        from mbd_ros.scene.task_reader import read_task

        task = read_task(arguments.task, scene).parts["simulate"]
        order = {name: getattr(task, name) for name in ("duration", *_RUN_ARGUMENTS)} | order
        task_options = dict(task.options)
        if options["integrator"] is None and options["tolerance"] is not None:
            options["integrator"] = task_options.get("integrator")
    if "duration" not in order:
        raise DataError("-t: is missing: give the seconds to simulate, or a --task")
    return Run(**order, options=task_options | options_of(scene, **options))

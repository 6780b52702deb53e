"""Words of `mbd-ros simulate`."""

import argparse
from typing import TYPE_CHECKING, Any

from mbd_ros.errors import OK, DataError
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.scene.schema.locate import path_word

if TYPE_CHECKING:
    from mbd_ros.features.simulation.run import Run
    from mbd_ros.scene.built_scene import Scene

_OPTIONS = ("dt", "integrator", "tolerance", "solver")
_NOT_OF_MANY = ("start", "efforts", "wrenches", "events", "task")
_RUN_ARGUMENTS = ("origin", "start", "efforts", "wrenches")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `simulate` understands."""
    add_scene(parser)
    parser.add_argument(
        "-t", "--time", type=float, help="seconds to simulate (required without --task)"
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="CSV (.gz), .npz, .parquet or bag (required)",
    )
    _add_method(parser)
    _add_inputs(parser)
    _add_tables(parser)


def _add_method(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--integrator", help="in place of that of the scene")
    parser.add_argument(
        "--tolerance",
        type=float,
        help="of the integrator, that of the scene too: largest error of a step (dopri5, dop853, "
        "filippov), of Newton's method (gauss_legendre, generalized_alpha, rattle, shake); the "
        "others have none",
    )
    parser.add_argument(
        "--dt", type=float, help="step, and interval of the output [s] (default: of the scene)"
    )
    parser.add_argument("--solver", help="entry type in place of that of the scene")
    parser.add_argument(
        "--compiled", action="store_true", help="steps in native code: --solver compiled"
    )


def _add_inputs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--from", dest="origin", type=path_word, help="CSV or bag with the state")
    parser.add_argument("--start", type=float, help="[s] (default: 0.0)")
    parser.add_argument(
        "--efforts",
        type=path_word,
        help="CSV: .command of actuators; CSV or bag: .effort",
    )
    parser.add_argument("--wrenches", type=path_word, help="CSV or bag of the external loads")


def _add_tables(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--ensemble",
        type=path_word,
        help="CSV, a run a row: initial states <joint>.position, .velocity, and numbers of parts "
        "<part>.<argument>; all runs go into one table",
    )
    add_workers(parser)
    parser.add_argument(
        "--events", type=path_word, help="the same kinds of file, for the table of events alone"
    )
    parser.add_argument(
        "--task",
        type=path_word,
        help="YAML whose section simulate says the same; options come before it",
    )


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
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
    simulate_to(scene, _asked(scene, arguments), arguments.out, say, arguments.events)
    return OK


def _run_ensemble(scene: "Scene", arguments: argparse.Namespace) -> int:
    """Many runs into one table; the exit code."""
    from mbd_ros.features.simulation.ensemble import ensemble_to

    for name, option in (("origin", "from"), *((n, n) for n in _NOT_OF_MANY)):
        if getattr(arguments, name) is not None:
            raise DataError(f"--{option}: does not go with --ensemble")
    where = arguments.workers, arguments.scheduler
    asked = _asked(scene, arguments)
    ensemble_to(scene, asked, arguments.ensemble, arguments.out, say, *where)
    return OK


def _asked(scene: "Scene", arguments: argparse.Namespace) -> "Run":
    """The order from the options, and else from the task file.

    Raises:
        MbdError: The file cannot be used, or the duration is missing.
    """
    from mbd_ros.features.simulation.run import Run, options_of

    words: dict[str, Any] = {"duration": arguments.time}
    words |= {name: getattr(arguments, name) for name in _RUN_ARGUMENTS}
    words = {name: word for name, word in words.items() if word is not None}
    given = {name: getattr(arguments, name) for name in _OPTIONS}
    if arguments.compiled:
        if given["solver"] not in (None, "compiled"):
            raise DataError(
                f"--compiled: beside --solver {given['solver']}; accepted: one of both"
            )
        given["solver"] = "compiled"
    replaced: dict[str, Any] = {}
    if arguments.task is not None:
        from mbd_ros.scene.task_reader import read_task

        task = read_task(arguments.task, scene).parts["simulate"]
        words = {name: getattr(task, name) for name in ("duration", *_RUN_ARGUMENTS)} | words
        replaced = dict(task.options)
        if given["integrator"] is None and given["tolerance"] is not None:
            given["integrator"] = replaced.get("integrator")
    if "duration" not in words:
        raise DataError("-t: is missing: give the seconds to simulate, or a --task")
    return Run(**words, options=replaced | options_of(scene, **given))

"""Words of `mbd-ros simulate`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.lines import say
from mbd_ros.scene.locate import path_word

_OPTIONS = ("dt", "integrator", "tolerance", "solver")
_RUN_ARGUMENTS = ("origin", "start", "efforts", "wrenches")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `simulate` understands."""
    add_scene(parser)
    parser.add_argument("-t", "--time", type=float, required=True, help="seconds to simulate")
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="CSV (.gz), .npz, .parquet or bag (required)",
    )
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
    parser.add_argument("--solver", help="tier in place of that of the scene")
    parser.add_argument("--from", dest="origin", type=path_word, help="CSV or bag with the state")
    parser.add_argument("--start", type=float, default=0.0, help="[s] (default: %(default)s)")
    parser.add_argument(
        "--efforts",
        type=path_word,
        help="CSV: .command of actuators; CSV or bag: .effort",
    )
    parser.add_argument("--wrenches", type=path_word, help="CSV or bag of the external loads")


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.jobs.simulate.run import Run, options_of
    from mbd_ros.jobs.simulate.to_file import simulate_to
    from mbd_ros.scene.reader import load_scene

    scene = load_scene(arguments.scene)
    options = options_of(scene, **{name: getattr(arguments, name) for name in _OPTIONS})
    words = {name: getattr(arguments, name) for name in _RUN_ARGUMENTS}
    run = Run(duration=arguments.time, options=options, **words)
    simulate_to(scene, run, arguments.out, say)
    return OK

"""mbd-ros: check | inverse | simulate | replay | demo | report."""

import argparse
import os
import sys
from collections.abc import Iterable, Sequence
from typing import Any

from mbd_ros.demo.command import add_demo, demo_lines
from mbd_ros.errors import (
    BAD_INPUT,
    FAILED,
    INTERRUPTED,
    OK,
    MbdError,
    install_hint,
    printable,
)
from mbd_ros.jobs.error_source import about
from mbd_ros.jobs.inverse.command import add_inverse, add_tuning, inverse_lines
from mbd_ros.report.command import add_report, report_lines
from mbd_ros.scene.code_permission import permitting
from mbd_ros.scene.locate import path_word

_ALLOW_CODE = "import the package.module:Class that a scene names; `check` lists them"
_RUN_ARGUMENTS = ("out", "origin", "start", "efforts", "wrenches")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: Words after `mbd-ros`; those of the process without it.

    Returns:
        0 ok, 1 a check failed, 2 bad input, 130 after Ctrl-C.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # two threads stall each other in small products
    arguments = _parser().parse_args(argv)
    try:
        with permitting(getattr(arguments, "allow_code", False)):
            return int(arguments.run(arguments))
    except MbdError as error:
        print(f"mbd-ros {arguments.command}: {error}", file=sys.stderr)
        return BAD_INPUT
    except ModuleNotFoundError as error:
        hint = install_hint(str(error.name))
        if not hint:
            raise
        print(f"mbd-ros {arguments.command}: {hint}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # `mbd-ros check ... | head`: nobody reads on
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="mbd-ros", description="Multibody dynamics of prostheses and robot arms."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    _add_check(commands)
    add_inverse(commands)
    commands.choices["inverse"].set_defaults(run=_inverse)
    _add_simulate(commands)
    _add_replay(commands)
    add_demo(commands)
    commands.choices["demo"].set_defaults(run=_demo)
    add_report(commands)
    commands.choices["report"].set_defaults(run=_report)
    for name in ("check", "inverse", "simulate", "replay", "report"):
        commands.choices[name].add_argument("--allow-code", action="store_true", help=_ALLOW_CODE)
    return parser


def _add_check(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    check = commands.add_parser("check", help="what a scene builds, leaves out and costs")
    check.add_argument("scene", type=path_word)
    check.set_defaults(run=_check)


def _add_simulate(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    simulate = commands.add_parser("simulate", help="motion from forces, with constraint forces")
    simulate.add_argument("scene", type=path_word)
    simulate.add_argument("-t", "--time", type=float, required=True, help="seconds to simulate")
    simulate.add_argument(
        "-o", "--out", type=path_word, required=True, help="CSV (.gz) or bag (required)"
    )
    simulate.add_argument("--integrator", help="in place of that of the scene")
    simulate.add_argument(
        "--tolerance",
        type=float,
        help="of the integrator, that of the scene too: largest error of a step (dopri5, dop853, "
        "filippov), of Newton's method (gauss_legendre, generalized_alpha, rattle, shake); the "
        "others have none",
    )
    simulate.add_argument(
        "--dt", type=float, help="step, and interval of the output [s] (default: of the scene)"
    )
    simulate.add_argument("--solver", help="tier in place of that of the scene")
    simulate.add_argument(
        "--from", dest="origin", type=path_word, help="CSV or bag with the state"
    )
    simulate.add_argument("--start", type=float, default=0.0, help="[s] (default: %(default)s)")
    simulate.add_argument(
        "--efforts",
        type=path_word,
        help="CSV: .command of actuators; CSV or bag: .effort",
    )
    simulate.add_argument("--wrenches", type=path_word, help="CSV or bag of the external loads")
    simulate.set_defaults(run=_simulate)


def _add_replay(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    replay = commands.add_parser("replay", help="a bag through the live node, with an error table")
    replay.add_argument("bag", type=path_word)
    replay.add_argument("scene", type=path_word)
    replay.add_argument(
        "-o", "--out", type=path_word, required=True, help="bag of the node's output (required)"
    )
    replay.add_argument("--rate", type=float, default=1.0, help="speed factor (default: 1)")
    replay.add_argument("--reference", help="JointState topic to compare with; else the effort")
    replay.add_argument(
        "--skip",
        type=float,
        default=0.5,
        help="seconds left out of the errors at the start (default: %(default)s)",
    )
    add_tuning(replay)
    replay.add_argument(
        "--topic",
        default="/joint_states",
        help="JointState topic of the bag (default: %(default)s)",
    )
    replay.set_defaults(run=_replay)


def _check(arguments: argparse.Namespace) -> int:
    from mbd_ros.scene.check import describe
    from mbd_ros.scene.reader import load_scene

    with about(arguments.scene):
        _say(describe(load_scene(arguments.scene)))
    return OK


def _inverse(arguments: argparse.Namespace) -> int:
    _say(inverse_lines(arguments))
    return OK


def _simulate(arguments: argparse.Namespace) -> int:
    from mbd_ros.jobs.simulate.inputs import Run, method_entry
    from mbd_ros.jobs.simulate.job import Interrupted, simulate
    from mbd_ros.scene.reader import load_scene

    scene = load_scene(arguments.scene)
    options: dict[str, Any] = {} if arguments.dt is None else {"dt": arguments.dt}
    method = method_entry(scene, arguments.integrator, arguments.tolerance)
    if method is not None:
        options["integrator"] = method
    if arguments.solver:
        options["solver"] = {"type": arguments.solver}
    run = Run(
        duration=arguments.time,
        options=options,
        **{name: getattr(arguments, name) for name in _RUN_ARGUMENTS},
    )
    try:
        _say(simulate(scene, run))
    except Interrupted as error:
        print(f"mbd-ros simulate: {error}", file=sys.stderr)
        return INTERRUPTED if error.by_user else FAILED
    return OK


def _replay(arguments: argparse.Namespace) -> int:
    from mbd_ros.jobs.replay.job import TORQUES, Replay, play
    from mbd_ros.jobs.torque_errors import compare
    from mbd_ros.scene.reader import load_scene

    joints = load_scene(arguments.scene).couplings.independent
    names = ("bag", "scene", "out", "rate", "topic", "cutoff")
    played, answered = play(Replay(**{name: getattr(arguments, name) for name in names}))
    print(f"{played} joint states played, {answered} answered, {played - answered} lost")
    reference = arguments.bag, arguments.reference or arguments.topic
    _say(compare((arguments.out, TORQUES), reference, joints, arguments.skip))
    return OK if answered == played else FAILED


def _demo(arguments: argparse.Namespace) -> int:
    from mbd_ros.demo.processes import Failed

    try:
        _say(demo_lines(arguments))
    except Failed as error:
        print(f"mbd-ros demo: {error}", file=sys.stderr)
        return FAILED
    return OK


def _report(arguments: argparse.Namespace) -> int:
    from mbd_ros.report.compose import Wrong

    try:
        _say(report_lines(arguments))
    except Wrong as error:
        print(f"mbd-ros report: {error}", file=sys.stderr)
        return FAILED
    return OK


def _say(lines: Iterable[str]) -> None:
    """Print lines as they come; names in them come from files of others."""
    for line in lines:
        print(printable(line), flush=True)


if __name__ == "__main__":
    sys.exit(main())

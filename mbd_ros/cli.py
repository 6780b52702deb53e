"""mbd-ros: check | inverse | simulate | replay | demo."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mbd_ros.errors import DataError, MbdError

_RUN_ARGUMENTS = ("out", "origin", "start", "efforts", "wrenches")
OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: Words after `mbd-ros`; those of the process without it.

    Returns:
        0 ok, 1 a check failed, 2 bad input.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # two threads stall each other in small products
    arguments = _parser().parse_args(argv)
    try:
        return int(arguments.run(arguments))
    except MbdError as error:
        print(f"mbd-ros {arguments.command}: {error}", file=sys.stderr)
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
    _add_inverse(commands)
    _add_simulate(commands)
    _add_replay(commands)
    _add_demo(commands)
    return parser


def _add_check(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    check = commands.add_parser("check", help="what a scene builds, leaves out and costs")
    check.add_argument("scene", type=Path)
    check.set_defaults(run=_check)


def _add_inverse(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    inverse = commands.add_parser("inverse", help="torques and coupling forces of a motion")
    inverse.add_argument("scene", type=Path)
    inverse.add_argument("motion", type=Path, help="CSV (.gz) or rosbag2 folder, .mcap or .db3")
    inverse.add_argument("-o", "--out", type=Path, required=True, help="CSV (.gz) or bag")
    inverse.add_argument("--wrenches", type=Path, help="CSV or bag; a bag motion carries its own")
    inverse.add_argument(
        "--derivatives",
        choices=("given", "causal", "zero-phase"),
        default="given",
        help="given: the motion has them; causal: filtered, lagging, as the node does; "
        "zero-phase: local polynomial fit that sees the future (default: %(default)s)",
    )
    inverse.add_argument(
        "--parts", action="store_true", help="also gravity, coriolis, inertial, .."
    )
    _add_tuning(inverse)
    inverse.add_argument("--half-width", type=int, default=4, help="samples, zero-phase only")
    inverse.add_argument("--topic", default="/joint_states", help="JointState topic of a bag")
    inverse.set_defaults(run=_inverse)


def _add_simulate(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    simulate = commands.add_parser("simulate", help="motion from forces, with constraint forces")
    simulate.add_argument("scene", type=Path)
    simulate.add_argument("-t", "--time", type=float, required=True, help="seconds to simulate")
    simulate.add_argument("-o", "--out", type=Path, required=True, help="CSV (.gz) or bag")
    simulate.add_argument("--integrator", help="in place of that of the scene")
    simulate.add_argument("--tolerance", type=float, help="error control of that integrator")
    simulate.add_argument("--dt", type=float, help="step, and interval of the output [s]")
    simulate.add_argument("--solver", help="tier in place of that of the scene")
    simulate.add_argument("--from", dest="origin", type=Path, help="CSV or bag with the state")
    simulate.add_argument("--start", type=float, default=0.0, help="time to begin at [s]")
    simulate.add_argument("--efforts", type=Path, help="CSV or bag: of actuators, else joints")
    simulate.add_argument("--wrenches", type=Path, help="CSV or bag of the external loads")
    simulate.set_defaults(run=_simulate)


def _add_replay(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    replay = commands.add_parser("replay", help="a bag through the live node, with an error table")
    replay.add_argument("bag", type=Path)
    replay.add_argument("scene", type=Path)
    replay.add_argument("-o", "--out", type=Path, required=True, help="bag of the node's output")
    replay.add_argument("--rate", type=float, default=1.0, help="speed factor (default: 1)")
    replay.add_argument("--reference", help="JointState topic to compare with; else the effort")
    replay.add_argument(
        "--skip", type=float, default=0.5, help="seconds left out of the errors at the start"
    )
    _add_tuning(replay)
    replay.add_argument("--topic", default="/joint_states", help="JointState topic of the bag")
    replay.set_defaults(run=_replay)


def _add_tuning(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cutoff", type=float, default=5.0, help="Hz, causal only")


def _add_demo(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    demo = commands.add_parser(
        "demo", help="the prosthetic arm through the live node, with a plot"
    )
    demo.add_argument("-o", "--out", type=Path, default=Path("demo_out"))
    demo.set_defaults(run=_demo)


def _check(arguments: argparse.Namespace) -> int:
    from mbd_ros.scene import load_scene
    from mbd_ros.scene_check import describe

    for line in describe(load_scene(arguments.scene)):
        print(line)
    return OK


def _inverse(arguments: argparse.Namespace) -> int:
    from mbd_ros.offline import Derivatives, inverse_dynamics_of
    from mbd_ros.scene import load_scene

    lines = inverse_dynamics_of(
        load_scene(arguments.scene),
        arguments.motion,
        arguments.out,
        derivatives=Derivatives(arguments.derivatives, arguments.cutoff, arguments.half_width),
        wrenches=arguments.wrenches,
        topic=arguments.topic,
        with_parts=arguments.parts,
    )
    for line in lines:
        print(line)
    return OK


def _simulate(arguments: argparse.Namespace) -> int:
    from mbd_ros.scene import load_scene
    from mbd_ros.simulate import Interrupted, simulate
    from mbd_ros.simulation_inputs import Run

    options: dict[str, Any] = {} if arguments.dt is None else {"dt": arguments.dt}
    if arguments.integrator:
        options["integrator"] = {"type": arguments.integrator}
        if arguments.tolerance is not None:
            options["integrator"]["tolerance"] = arguments.tolerance
    elif arguments.tolerance is not None:
        raise DataError("--tolerance goes with --integrator")
    if arguments.solver:
        options["solver"] = {"type": arguments.solver}
    run = Run(
        duration=arguments.time,
        options=options,
        **{name: getattr(arguments, name) for name in _RUN_ARGUMENTS},
    )
    try:
        for line in simulate(load_scene(arguments.scene), run):
            print(line)
    except Interrupted as error:
        print(f"mbd-ros simulate: {error}", file=sys.stderr)
        return FAILED
    return OK


def _replay(arguments: argparse.Namespace) -> int:
    from mbd_ros.replay import TORQUES, Replay, play
    from mbd_ros.report.torque_errors import compare
    from mbd_ros.scene import load_scene

    joints = load_scene(arguments.scene).couplings.independent
    names = ("bag", "scene", "out", "rate", "topic", "cutoff")
    played, answered = play(Replay(**{name: getattr(arguments, name) for name in names}))
    print(f"{played} joint states played, {answered} answered, {played - answered} lost")
    reference = arguments.bag, arguments.reference or arguments.topic
    for line in compare((arguments.out, TORQUES), reference, joints, arguments.skip):
        print(line)
    return OK if answered == played else FAILED


def _demo(arguments: argparse.Namespace) -> int:
    from mbd_ros.report.demo import demo

    for line in demo(arguments.out):
        print(line)
    return OK


if __name__ == "__main__":
    sys.exit(main())

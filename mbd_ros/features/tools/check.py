"""The command `mbd-ros check`: the parts that a scene builds, and the cost of a step."""

import argparse
from dataclasses import replace

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import about, add_scene
from mbd_ros.jobs.progress import announce, say_all


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `check`."""
    add_scene(parser)
    parser.add_argument(
        "--compiled",
        action="store_true",
        help="Compile the scene as solver auto does, and print the cost of a step, or why it "
        "cannot be compiled.",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the report and return the exit code."""
    from mbd_ros.scene.describe.check import describe
    from mbd_ros.scene.reader import is_of_particles, load_any

    with about(arguments.scene):
        scene = load_any(arguments.scene)
        if is_of_particles(scene):
            from mbd_ros.scene.describe.particles import describe as describe_particles

            say_all(describe_particles(scene))
            return OK
        if arguments.compiled and not scene.solver.compiles:
            scene = scene.holding(solver=replace(scene.solver, type="auto"))
        say_all(describe(scene, announce))
    return OK

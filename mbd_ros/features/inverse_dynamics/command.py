"""Words of `mbd-ros inverse`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.motion.options import (
    add_derivatives,
    add_motions,
    add_stance,
    add_time_range,
    add_wrench_axes,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `inverse` understands."""
    add_scene(parser)
    add_motions(parser)
    add_time_range(parser)
    add_wrench_axes(parser)
    add_derivatives(parser)
    parser.add_argument(
        "--parts",
        action="store_true",
        help="also gravity, coriolis, inertial, ..; refused for scenes with loops",
    )
    parser.add_argument(
        "--bounds",
        action="store_true",
        help="efforts within the limits of actuators, stops and friction within their laws",
    )
    parser.add_argument(
        "--power",
        action="store_true",
        help="also powers of joints, parts and segments, and their balance",
    )
    add_stance(parser)
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.inverse_dynamics.job import inverse_batch
    from mbd_ros.motion.batch import batch_of

    names = ("parts", "bounds", "power", "stance", "stance_gap", "stance_speed")
    options = {name: getattr(arguments, name) for name in names}
    inverse_batch(batch_of(arguments, options), say)
    return OK

"""The command `mbd-ros inverse`: torques and constraint forces of recorded motions."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.jobs.workers.opening import add_workers
from mbd_ros.motion.options import (
    add_bounds,
    add_derivatives,
    add_motions,
    add_stance,
    add_time_range,
    add_torque_parts,
    add_wrench_axes,
)

_OPTIONS = ("parts", "bounds", "power", "stance", "stance_gap", "stance_speed")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `inverse`."""
    add_scene(parser)
    add_motions(parser)
    add_time_range(parser)
    add_wrench_axes(parser)
    add_derivatives(parser)
    add_torque_parts(parser)
    add_bounds(parser)
    add_stance(parser)
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    """Solve all motions and return the exit code."""
    from mbd_ros.features.inverse_dynamics.job import inverse_batch
    from mbd_ros.motion.batch import batch_of

    options = {name: getattr(arguments, name) for name in _OPTIONS}
    inverse_batch(batch_of(arguments, options), say)
    return OK

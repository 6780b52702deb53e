"""The command `mbd-ros check`: parts that a scene builds and leaves out, and their cost."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.error_source import about
from mbd_ros.jobs.lines import say_all


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `check` understands."""
    add_scene(parser)


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.scene.check import describe
    from mbd_ros.scene.reader import load_scene

    with about(arguments.scene):
        say_all(describe(load_scene(arguments.scene)))
    return OK

"""Words of `mbd-ros demo`."""

import argparse
from pathlib import Path

from mbd_ros.demo.choices import LAWS, ROBOTS
from mbd_ros.errors import OK
from mbd_ros.jobs.lines import say_all
from mbd_ros.scene.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `demo` understands."""
    robots = "; ".join(f"{name}: {robot.title}" for name, robot in ROBOTS.items())
    parser.add_argument("robot", nargs="?", choices=list(ROBOTS), default="arm", help=robots)
    folder, text = Path("demo_out"), "folder of bag and page (default: %(default)s)"
    parser.add_argument("-o", "--out", type=path_word, default=folder, metavar="DIR", help=text)
    parser.add_argument("--time", type=float, default=10.0, help="simulated seconds (default: 10)")
    parser.add_argument(
        "--controller", choices=list(LAWS), default="sliding_mode", help="(default: %(default)s)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.demo.run import Demo, demo

    order = Demo(arguments.robot, arguments.out, arguments.time, arguments.controller)
    say_all(demo(order))
    return OK

"""Words of `mbd-ros demo`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from mbd_ros.demo.choices import LAWS, ROBOTS
from mbd_ros.scene.locate import path_word


def add_demo(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """The words that `demo` understands."""
    robots = "; ".join(f"{name}: {robot.title}" for name, robot in ROBOTS.items())
    demo = commands.add_parser("demo", help="a simulated robot, controlled over topics: one page")
    demo.add_argument("robot", nargs="?", choices=list(ROBOTS), default="arm", help=robots)
    folder, text = Path("demo_out"), "folder of bag and page (default: %(default)s)"
    demo.add_argument("-o", "--out", type=path_word, default=folder, metavar="DIR", help=text)
    demo.add_argument("--time", type=float, default=10.0, help="simulated seconds (default: 10)")
    demo.add_argument(
        "--controller", choices=list(LAWS), default="sliding_mode", help="(default: %(default)s)"
    )


def demo_lines(arguments: argparse.Namespace) -> Iterator[str]:
    """Run what the words say, line by line."""
    from mbd_ros.demo.run import Demo, demo

    order = Demo(arguments.robot, arguments.out, arguments.time, arguments.controller)
    return demo(order)

"""Words of `mbd-ros demo`."""

import argparse
from pathlib import Path

from mbd_ros.applications.demo.task import LAWS, ROBOTS, TWIN, WALKING
from mbd_ros.errors import OK, DataError
from mbd_ros.jobs.progress import say_all
from mbd_ros.scene.schema.locate import path_word

_WALKING, _TWIN = "walking", "twin"
_GIVEN = {
    _WALKING: "its time is that of a swing, and muscles move it",
    _TWIN: "its time is that of its fault, and a motor moves it",
}
_TIME, _LAW = 10.0, "sliding_mode"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `demo` understands."""
    robots = "; ".join(f"{name}: {robot.title}" for name, robot in ROBOTS.items())
    text = f"{robots}; without topics {_WALKING}: {WALKING}; {_TWIN}: {TWIN}"
    choices = [*ROBOTS, _WALKING, _TWIN]
    parser.add_argument("robot", nargs="?", choices=choices, default="arm", help=text)
    folder, text = Path("demo_out"), "folder of bag and page (default: %(default)s)"
    parser.add_argument("-o", "--out", type=path_word, default=folder, metavar="DIR", help=text)
    text = f"simulated seconds of a robot (default: {_TIME:g})"
    parser.add_argument("--time", type=float, help=text)
    text = f"of a robot (default: {_LAW})"
    parser.add_argument("--controller", choices=list(LAWS), help=text)


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    time, law = arguments.time, arguments.controller
    if arguments.robot in (_WALKING, _TWIN):
        if time is not None or law is not None:
            raise DataError(
                f"{arguments.robot}: {_GIVEN[arguments.robot]}; "
                "--time and --controller are for robots"
            )
        from mbd_ros.applications.demo.twin import twin
        from mbd_ros.applications.demo.walking import walking

        say_all((twin if arguments.robot == _TWIN else walking)(arguments.out))
        return OK
    from mbd_ros.applications.demo.run import Demo, demo

    order = Demo(arguments.robot, arguments.out, _TIME if time is None else time, law or _LAW)
    say_all(demo(order))
    return OK

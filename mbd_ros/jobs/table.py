"""The commands of `mbd-ros`, a line each; the options of a command stand in its module only.

The module of a command has two functions: `add_arguments(parser)` declares its options, and
`run(arguments) -> int` does what they say and returns the exit code of the program.
"""

from collections.abc import Mapping
from typing import NamedTuple


class Command(NamedTuple):
    """A line of `COMMANDS`.

    Attributes:
        module: Imported when the command is asked for.
        text: What it does, for the help of the program.
    """

    module: str
    text: str


COMMANDS: Mapping[str, Command] = {
    "check": Command("mbd_ros.jobs.check", "what a scene builds, leaves out and costs"),
    "scenes": Command("mbd_ros.jobs.scenes", "the embedded scenes, with a line each"),
    "inverse": Command("mbd_ros.jobs.inverse.command", "torques and coupling forces of a motion"),
    "simulate": Command(
        "mbd_ros.jobs.simulate.command", "motion from forces, with constraint forces"
    ),
    "replay": Command(
        "mbd_ros.jobs.replay.command", "a bag through the live node, with an error table"
    ),
    "demo": Command("mbd_ros.demo.command", "a simulated robot, controlled over topics: one page"),
    "report": Command(
        "mbd_ros.report.command", "error against run time, stability and cost, on one page"
    ),
}

"""The commands of `mbd-ros`, a line each; the options of a command stand in its module only.

The module of a command has two functions: `add_arguments(parser)` declares its options, and
`run(arguments) -> int` runs it and returns the exit code of the program.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple, Protocol

from mbd_ros.errors import MbdError

if TYPE_CHECKING:
    import argparse
    from importlib.metadata import EntryPoint

GROUP = "mbd_ros.commands"  # entry points of other packages: name -> module


class CommandError(MbdError):
    """A command that does not exist or cannot be used."""


class Command(NamedTuple):
    """A line of `COMMANDS`.

    Attributes:
        module: Imported when the command is asked for.
        text: What it does, for the help of the program.
    """

    module: str
    text: str


class CommandModule(Protocol):
    """Contract of the module of a command."""

    def add_arguments(self, parser: "argparse.ArgumentParser") -> None:
        """Declare the options."""

    def run(self, arguments: "argparse.Namespace") -> int:
        """Do what the options say; the exit code."""


COMMANDS: Mapping[str, Command] = {
    "check": Command("mbd_ros.features.tools.check", "what a scene builds, leaves out and costs"),
    "scenes": Command("mbd_ros.features.tools.scenes", "the embedded scenes, with a line each"),
    "inverse": Command(
        "mbd_ros.features.inverse_dynamics.command", "torques and coupling forces of a motion"
    ),
    "simulate": Command(
        "mbd_ros.features.simulation.command", "motion from forces, with constraint forces"
    ),
    "scale": Command(
        "mbd_ros.features.markers.scale.command", "a scene of a person's size, from a static trial"
    ),
    "kinematics": Command(
        "mbd_ros.features.markers.command", "motion of all joints from recorded markers"
    ),
    "loads": Command(
        "mbd_ros.features.loads.command", "loads on one body of a motion, for finite elements"
    ),
    "moment-arms": Command(
        "mbd_ros.features.muscles.moment_arms.command",
        "lengths, speeds and moment arms of paths in a motion",
    ),
    "muscles": Command(
        "mbd_ros.features.muscles.command", "forces of muscles and loads of joints of a motion"
    ),
    "identify": Command(
        "mbd_ros.features.identification.command",
        "inertias and friction from motion and measured efforts",
    ),
    "learn": Command(
        "mbd_ros.features.identification.learn.command",
        "a network for what physics leaves of measured torques",
    ),
    "estimate": Command(
        "mbd_ros.features.estimation.command",
        "motion of all joints from noisy and partial recordings",
    ),
    "excite": Command(
        "mbd_ros.features.identification.excite.command",
        "a trajectory that shows masses, within all limits",
    ),
    "payload": Command(
        "mbd_ros.features.identification.payload.command",
        "mass, centre and inertia of what a gripper holds",
    ),
    "gait": Command(
        "mbd_ros.features.gait.command",
        "periodic walking: multipliers, branches, basin of attraction",
    ),
    "follow": Command(
        "mbd_ros.features.control.command",
        "gains that lead a robot back to a motion, and how far off",
    ),
    "predict": Command(
        "mbd_ros.features.prediction.command", "the motion that costs least, by optimal control"
    ),
    "bracket": Command(
        "mbd_ros.features.dirac_brackets.command",
        "Dirac brackets of coordinates and momenta on the rows",
    ),
    "sample": Command(
        "mbd_ros.features.sampling.command",
        "configurations at a temperature; mean forces along them",
    ),
    "replay": Command(
        "mbd_ros.features.replay.command", "a bag through the live node, with an error table"
    ),
    "import-opensim": Command(
        "mbd_ros.features.model_import.command", "a model of OpenSim as a URDF and a scene"
    ),
    "import-mjcf": Command(
        "mbd_ros.features.model_import.command", "a model of MuJoCo as a URDF and a scene"
    ),
    "params": Command("mbd_ros.nodes.command", "a parameter file of a node, with comments"),
    "plot": Command("mbd_ros.features.tools.plot", "a picture of a result"),
    "view": Command("mbd_ros.view.command", "a scene and its motion in a browser"),
    "demo": Command(
        "mbd_ros.applications.demo.command", "a simulated robot, controlled over topics: one page"
    ),
    "report": Command(
        "mbd_ros.applications.report.command",
        "error against run time, stability and cost, on one page",
    ),
    "completion": Command(
        "mbd_ros.features.tools.completion", "a script that completes words in a shell"
    ),
}


def command_module(name: str) -> CommandModule:
    """Import a command.

    Args:
        name: A line of `COMMANDS`, or else a command that an installed package adds as an entry
            point of the group `mbd_ros.commands`; these are looked up for names that are not in
            the table, and for no others.

    Raises:
        CommandError: There is none, with the nearest and all that there are; or the module
            cannot be imported, or lacks a function.
    """
    if name in COMMANDS:
        return import_module(COMMANDS[name].module)
    points = added_commands()
    if name not in points:
        from mbd_ros.scene.schema.nearest import nearest  # here, since they serve errors only
        from mbd_ros.scene.schema.renamed import renamed

        close = nearest(name, [*COMMANDS, *points], 1)
        hint = f"the nearest is '{close[0]}', " if close else ""
        accepted = f"{hint}accepted: {', '.join([*COMMANDS, *points])}"
        raise CommandError(f"there is no command '{name}'{renamed('command', name)}; {accepted}")
    where = f"command '{name}' ({points[name].value})"
    try:
        module = points[name].load()
    except (ImportError, SyntaxError, AttributeError) as error:
        raise CommandError(f"{where} cannot be imported: {error}") from error
    for function in ("add_arguments", "run"):
        if not callable(getattr(module, function, None)):
            raise CommandError(f"{where} has no function '{function}'")
    return module


def added_commands() -> "dict[str, EntryPoint]":
    """The commands of other packages, by name."""
    from importlib.metadata import entry_points  # takes longer than all else here

    return {point.name: point for point in sorted(entry_points(group=GROUP))}

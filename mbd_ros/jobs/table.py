"""The table of the commands of `mbd-ros`; the options of a command stand in its module only.

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
        module: Module of the command, which is imported when the command runs.
        text: Description for the help of the program.
    """

    module: str
    text: str


class CommandModule(Protocol):
    """Contract of the module of a command."""

    def add_arguments(self, parser: "argparse.ArgumentParser") -> None:
        """Declare the arguments of the command."""

    def run(self, arguments: "argparse.Namespace") -> int:
        """Run the command and return the exit code."""


COMMANDS: Mapping[str, Command] = {
    "check": Command(
        "mbd_ros.features.tools.check",
        "Report the parts that a scene builds, and the cost of a step.",
    ),
    "scenes": Command("mbd_ros.features.tools.scenes", "List the scenes of this package."),
    "inverse": Command(
        "mbd_ros.features.inverse_dynamics.command",
        "Compute the joint torques and constraint forces of recorded motions.",
    ),
    "simulate": Command(
        "mbd_ros.features.simulation.command",
        "Simulate a scene: its motion, constraint forces and energy.",
    ),
    "scale": Command(
        "mbd_ros.features.markers.scale.command", "Scale a scene to a person, from a static trial."
    ),
    "kinematics": Command(
        "mbd_ros.features.markers.command",
        "Compute the motion of all joints from recorded markers.",
    ),
    "loads": Command(
        "mbd_ros.features.loads.command",
        "Compute the loads on one body of a motion, also for finite elements.",
    ),
    "moment-arms": Command(
        "mbd_ros.features.muscles.moment_arms.command",
        "Compute lengths, speeds and moment arms of paths in a motion.",
    ),
    "muscles": Command(
        "mbd_ros.features.muscles.command",
        "Compute muscle forces and joint loads of recorded motions.",
    ),
    "identify": Command(
        "mbd_ros.features.identification.command",
        "Identify inertias and friction from motions and measured efforts.",
    ),
    "learn": Command(
        "mbd_ros.features.identification.learn.command",
        "Train a network on the torques that the equations of motion do not explain.",
    ),
    "estimate": Command(
        "mbd_ros.features.estimation.command",
        "Estimate the motion of all joints from noisy and partial recordings.",
    ),
    "excite": Command(
        "mbd_ros.features.identification.excite.command",
        "Find a trajectory within all limits that makes inertias identifiable.",
    ),
    "payload": Command(
        "mbd_ros.features.identification.payload.command",
        "Identify mass, centre and inertia of what a gripper holds.",
    ),
    "gait": Command(
        "mbd_ros.features.gait.command",
        "Find periodic gaits: their multipliers, branches and basin of attraction.",
    ),
    "follow": Command(
        "mbd_ros.features.control.command",
        "Compute the feedback gains that hold a robot on a motion.",
    ),
    "predict": Command(
        "mbd_ros.features.prediction.command",
        "Compute the motion of least cost by optimal control.",
    ),
    "bracket": Command(
        "mbd_ros.features.dirac_brackets.command",
        "Compute the Dirac brackets of coordinates and momenta.",
    ),
    "sample": Command(
        "mbd_ros.features.sampling.command",
        "Sample configurations at a temperature, and mean forces along a coordinate.",
    ),
    "replay": Command(
        "mbd_ros.features.replay.command",
        "Play a bag through the live node, and compare its torques.",
    ),
    "import-opensim": Command(
        "mbd_ros.features.model_import.command",
        "Convert a model of OpenSim to a URDF and a scene.",
    ),
    "import-mjcf": Command(
        "mbd_ros.features.model_import.command", "Convert a model of MuJoCo to a URDF and a scene."
    ),
    "params": Command("mbd_ros.nodes.command", "Print a parameter file of a node, with comments."),
    "plot": Command("mbd_ros.features.tools.plot", "Draw a picture of a result."),
    "view": Command("mbd_ros.view.command", "Show a scene and its motion in a browser."),
    "demo": Command(
        "mbd_ros.applications.demo.command",
        "Simulate a robot that is controlled over topics, and report on one page.",
    ),
    "report": Command(
        "mbd_ros.applications.report.command",
        "Measure error against run time, stability and cost, and report on one page.",
    ),
    "completion": Command(
        "mbd_ros.features.tools.completion",
        "Print a script that completes the command line in a shell.",
    ),
}


def command_module(name: str) -> CommandModule:
    """Import the module of a command.

    Args:
        name: Name in `COMMANDS`, or name of a command that an installed package adds as an entry
            point of the group `mbd_ros.commands`. Entry points are searched only for names that
            are not in the table.

    Raises:
        CommandError: There is no such command (the message lists all commands, the nearest
            spelling first), its module cannot be imported, or the module has no function
            `add_arguments` or `run`.
    """
    if name in COMMANDS:
        return import_module(COMMANDS[name].module)
    points = added_commands()
    if name not in points:
        from mbd_ros.scene.schema.nearest import nearest  # here, since only errors need them
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
    """Return the commands of other packages, by name."""
    from importlib.metadata import entry_points  # takes longer than all else here

    return {point.name: point for point in sorted(entry_points(group=GROUP))}

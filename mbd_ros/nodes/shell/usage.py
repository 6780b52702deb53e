"""Words after the name of a node's executable: --help, and words that nobody reads."""

import sys
import textwrap
from collections.abc import Sequence

from rclpy.utilities import remove_ros_args

from mbd_ros.errors import BAD_INPUT
from mbd_ros.nodes.shell.parameters import Parameter

_HELP = ("-h", "--help")


def asks_for_help(arguments: Sequence[str], name: str) -> bool:
    """Whether somebody wants to read the usage.

    Args:
        arguments: Command line with program name.
        name: Of the node.

    Raises:
        SystemExit: 2 after naming a word that is neither ROS's nor a wish for help.
        RCLError: A command line or parameter file that rcl refuses.
    """
    words = remove_ros_args(list(arguments))[1:]
    if any(word in _HELP for word in words):
        return True
    if words:
        sys.stderr.write(
            f"{name}: unknown argument '{words[0]}'; accepted: --help, and after --ros-args what "
            f"ROS takes: -p scene:=SCENE, --params-file FILE, -r FROM:=TO\n"
        )
        raise SystemExit(BAD_INPUT)
    return False


def usage(name: str, parameters: Sequence[Parameter]) -> str:
    """Text for --help: how to start the node, and every parameter with its default."""
    from mbd_ros.nodes.shell.params_file import meaning  # here, since nodes start without it

    lines = [
        f"usage: ros2 run mbd_ros {name} --ros-args -p scene:=SCENE [-p NAME:=VALUE] "
        "[--params-file FILE] [-r FROM:=TO]",
        "",
        "parameters:",
    ]
    for parameter in parameters:
        default = parameter.default
        shown = list(default) if isinstance(default, tuple) else default
        given = "required" if default is None else f"default {str(shown).replace('True', 'true')}"
        lines.append(f"  {parameter.name} ({given.replace('False', 'false')})")
        lines += textwrap.wrap(
            meaning(parameter), 92, initial_indent=" " * 6, subsequent_indent=" " * 6
        )
    return "\n".join(lines) + "\n"

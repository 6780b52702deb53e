"""The program `mbd-ros`: parse the command line and run one command.

Only the module of that command is imported.
"""

import argparse
import os
import sys
from collections.abc import Sequence

from mbd_ros.errors import BAD_INPUT, INTERRUPTED, OK, MbdError, install_hint
from mbd_ros.jobs.table import COMMANDS, CommandError, command_module
from mbd_ros.scene.schema.code_permission import permitting

_EXAMPLE = "mbd-ros simulate prosthetic_leg -t 1 -o swing.csv"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: Arguments after `mbd-ros`; by default those of the process.

    Returns:
        Exit code: 0 on success, 1 if a check failed, 2 for bad input, 130 after Ctrl-C.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # two threads stall each other in small products
    arguments = list(sys.argv[1:] if argv is None else argv)
    name = arguments[0] if arguments else ""
    try:
        return _run(name, arguments)
    except MbdError as error:
        print(f"mbd-ros {name}: {error}", file=sys.stderr)
        return error.exit_code
    except ModuleNotFoundError as error:
        hint = install_hint(str(error.name))
        if not hint:
            raise
        print(f"mbd-ros {name}: {hint}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # `mbd-ros check ... | head`: the reader closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK


def _run(name: str, argv: Sequence[str]) -> int:
    """Parse the arguments and run the command.

    Without arguments, the program prints its help on stderr and exits with code 2, so that a
    script whose command is an empty variable stops.
    """
    parser, commands = _parser()
    if not argv:
        parser.exit(BAD_INPUT, parser.format_help())
    if name.startswith("-"):
        parser.parse_args(argv)
        parser.error("the command must come before its options")
    try:
        module = command_module(name)
    except CommandError as error:
        parser.error(str(error))
    if name not in COMMANDS:
        commands.add_parser(name, description=(module.__doc__ or "").partition("\n\n")[0])
    module.add_arguments(commands.choices[name])
    arguments, unknown = parser.parse_known_args(argv)
    if unknown:
        commands.choices[name].error(_unknown_arguments(unknown))
    with permitting(getattr(arguments, "allow_code", False)):
        return int(module.run(arguments))


def _unknown_arguments(arguments: Sequence[str]) -> str:
    """Return the error message for unknown arguments, with the new names of renamed options."""
    from mbd_ros.scene.schema.renamed import renamed  # here, since only errors need it

    hints = "".join(renamed("option", argument.partition("=")[0]) for argument in arguments)
    return f"unrecognized arguments: {' '.join(arguments)}{hints}"


def _parser() -> tuple[
    argparse.ArgumentParser, "argparse._SubParsersAction[argparse.ArgumentParser]"
]:
    """Return a parser that knows all commands of the table, but none of their options yet."""
    parser = argparse.ArgumentParser(
        prog="mbd-ros",
        description="Multibody dynamics of prostheses and robot arms.",
        epilog=f"example: {_EXAMPLE}",
    )
    parser.add_argument("--version", action=_ShowVersion, nargs=0, help="show version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, command in COMMANDS.items():
        commands.add_parser(name, help=command.text, description=command.text)
    return parser, commands


class _ShowVersion(argparse.Action):
    """Print the version; it is looked up only now, since that takes time."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"mbd-ros {version('mbd_ros')}")
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())

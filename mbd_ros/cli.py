"""The program `mbd-ros`: it imports the command that is asked for, and no other."""

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
        argv: Words after `mbd-ros`; those of the process without it.

    Returns:
        0 ok, 1 a check failed, 2 bad input, 130 after Ctrl-C.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # two threads stall each other in small products
    words = list(sys.argv[1:] if argv is None else argv)
    name = words[0] if words else ""
    try:
        return _run(name, words)
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
    except BrokenPipeError:  # `mbd-ros check ... | head`: nobody reads on
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK


def _run(name: str, words: Sequence[str]) -> int:
    """Parse the words and run the command.

    Without words the program shows its help and an example, as a mistake: exit code 2, on stderr,
    so that a script whose command is an empty variable stops.
    """
    parser, commands = _parser()
    if not words:
        parser.exit(BAD_INPUT, parser.format_help())
    if name.startswith("-"):
        parser.parse_args(words)
        parser.error("the command comes first")
    try:
        module = command_module(name)
    except CommandError as error:
        parser.error(str(error))
    if name not in COMMANDS:
        commands.add_parser(name, description=(module.__doc__ or "").partition("\n\n")[0])
    module.add_arguments(commands.choices[name])
    arguments, unknown = parser.parse_known_args(words)
    if unknown:
        commands.choices[name].error(_unknown(unknown))
    with permitting(getattr(arguments, "allow_code", False)):
        return int(module.run(arguments))


def _unknown(words: Sequence[str]) -> str:
    """Why words that no option takes are refused."""
    from mbd_ros.scene.schema.renamed import renamed  # here, since it serves errors only

    hints = "".join(renamed("option", word.partition("=")[0]) for word in words)
    return f"unrecognized arguments: {' '.join(words)}{hints}"


def _parser() -> tuple[
    argparse.ArgumentParser, "argparse._SubParsersAction[argparse.ArgumentParser]"
]:
    """The parser with all commands of the table, which have no options yet."""
    parser = argparse.ArgumentParser(
        prog="mbd-ros",
        description="Multibody dynamics of prostheses and robot arms.",
        epilog=f"example: {_EXAMPLE}",
    )
    parser.add_argument("--version", action=_ShowVersion, nargs=0, help="show it and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, command in COMMANDS.items():
        commands.add_parser(name, help=command.text, description=command.text)
    return parser, commands


class _ShowVersion(argparse.Action):
    """Looks the version up when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *words: object) -> None:
        from importlib.metadata import version

        print(f"mbd-ros {version('mbd_ros')}")
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())

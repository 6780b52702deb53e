"""The program `mbd-ros`: it imports the command that is asked for, and no other."""

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module

from mbd_ros.errors import BAD_INPUT, INTERRUPTED, OK, MbdError, install_hint
from mbd_ros.jobs.table import COMMANDS
from mbd_ros.scene.code_permission import permitting


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
    parser = argparse.ArgumentParser(
        prog="mbd-ros", description="Multibody dynamics of prostheses and robot arms."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for known, command in COMMANDS.items():
        commands.add_parser(known, help=command.text, description=command.text)
    if name not in COMMANDS:
        parser.parse_args(words)
        parser.error("the command comes first")
    module = import_module(COMMANDS[name].module)
    module.add_arguments(commands.choices[name])
    arguments = parser.parse_args(words)
    with permitting(getattr(arguments, "allow_code", False)):
        return int(module.run(arguments))


if __name__ == "__main__":
    sys.exit(main())

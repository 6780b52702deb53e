"""Generate the reference of commands from their parsers."""

import argparse
from collections.abc import Iterator

from tables import code, table

from mbd_ros.jobs.table import COMMANDS, command_module

_HEAD = """\
# Commands and options

With this page you can look up every command with its arguments and options. `make docs` generates
it from the parsers, which also print `mbd-ros COMMAND --help`. [command_line.md](command_line.md)
says what all commands share.
"""


def page() -> str:
    """Return the page as Markdown."""
    overview = table(
        ("command", "does"),
        ((f"[`{name}`](#{name})", command.text) for name, command in COMMANDS.items()),
    )
    pieces = [_HEAD, overview]
    for name in COMMANDS:
        pieces += [f"## {name}", *_command(name)]
    return "\n\n".join(pieces) + "\n"


def _command(name: str) -> Iterator[str]:
    parser = argparse.ArgumentParser(f"mbd-ros {name}", formatter_class=_Wide)
    command_module(name).add_arguments(parser)
    yield COMMANDS[name].text
    if parser.description and parser.description != COMMANDS[name].text:
        yield parser.description
    yield f"```text\n{parser.format_usage().removeprefix('usage: ').strip()}\n```"
    actions = [a for a in parser._actions if a.dest != "help"]  # argparse shows them nowhere else
    if actions:
        yield table(("argument", "means"), ((code(_usage(a)), _text(a)) for a in actions))


class _Wide(argparse.HelpFormatter):
    """A formatter with lines as long as a page is wide, on any terminal."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=96)


def _usage(action: argparse.Action) -> str:
    """Return an argument as a command line contains it."""
    choices = "|".join(map(str, action.choices)) if action.choices else ""
    metavar = action.metavar
    values = (metavar if isinstance(metavar, str) else " ".join(metavar or ())) or choices
    if not action.option_strings:
        return values or action.dest.upper()
    value = "" if action.nargs == 0 else f" {values or action.dest.upper()}"
    return ", ".join(action.option_strings) + value


def _text(action: argparse.Action) -> str:
    return (action.help or "") % {**vars(action), "prog": "mbd-ros"}

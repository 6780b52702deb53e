"""Words of the command line and their places, read from the parsers of the commands."""

import argparse
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from mbd_ros.jobs.arguments import names_scenes
from mbd_ros.jobs.table import COMMANDS, added_commands, command_module
from mbd_ros.scene.schema.locate import embedded_scenes, path_word


class Option(NamedTuple):
    """An option of a command.

    Attributes:
        names: Such as `-o` and `--out`.
        text: What it does.
        takes: Whether a value follows it.
        values: The possible values, where they can be listed.
        files: Whether the value is a file.
    """

    names: Sequence[str]
    text: str
    takes: bool
    values: Sequence[str]
    files: bool


class Words(NamedTuple):
    """Words that may follow a command.

    Attributes:
        text: What the command does.
        options: Its options.
        values: Words without a dash, where they can be listed.
        files: Whether files may stand there.
    """

    text: str
    options: Sequence[Option]
    values: Sequence[str]
    files: bool


def all_words() -> Mapping[str, Words]:
    """Command -> what may follow it; of commands of other packages only the name."""
    scenes = list(embedded_scenes())
    found = {name: _words(name, scenes) for name in COMMANDS}
    return found | {
        name: Words("", (), (), True) for name in added_commands() if name not in found
    }


def _words(name: str, scenes: Sequence[str]) -> Words:
    parser = argparse.ArgumentParser()
    command_module(name).add_arguments(parser)
    options: list[Option] = []
    values: list[str] = []
    files = False
    for argument in parser._actions:  # argparse shows them nowhere else
        known = scenes if names_scenes(argument) else list(map(str, argument.choices or ()))
        is_file = argument.type is path_word or names_scenes(argument)
        if argument.option_strings:
            names, text = argument.option_strings, (argument.help or "") % vars(argument)
            options.append(Option(names, text, argument.nargs != 0, known, is_file))
        else:
            values += known
            files |= is_file
    return Words(COMMANDS[name].text, options, values, files)

"""The command `mbd-ros completion`: scripts that complete the command line in a shell.

Commands, options and values are read from the parsers of the commands.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from shlex import join, quote
from typing import NamedTuple

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import names_scenes
from mbd_ros.jobs.table import COMMANDS, added_commands, command_module
from mbd_ros.scene.schema.locate import embedded_scenes, path_word

_TOP = ("--help", "--version")
_BASH = """\
_mbd_ros() {
  local current=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]} words= files=
  if (( COMP_CWORD == 1 )); then words=@TOP@
  else case ${COMP_WORDS[1]} in"""
_BASH_END = """\
  esac; fi
  mapfile -t COMPREPLY < <(compgen -W "$words" -- "$current")
  if [[ $files ]]; then
    compopt -o filenames 2>/dev/null
    mapfile -t -O ${#COMPREPLY[@]} COMPREPLY < <(compgen -f -- "$current")
  fi
}
complete -F _mbd_ros mbd-ros"""
_ZSH = """\
#compdef mbd-ros
_mbd_ros() {
  local current=$words[CURRENT] before=$words[CURRENT-1]
  if (( CURRENT == 2 )); then compadd -- @TOP@
  else case $words[2] in"""
_ZSH_END = """\
  esac; fi
}
compdef _mbd_ros mbd-ros"""


class Option(NamedTuple):
    """An option of a command.

    Attributes:
        names: Spellings, such as `-o` and `--out`.
        text: Description.
        takes: Whether a value follows.
        values: The accepted values, if they can be listed.
        files: Whether the value is a file.
    """

    names: Sequence[str]
    text: str
    takes: bool
    values: Sequence[str]
    files: bool


class CommandArguments(NamedTuple):
    """Arguments that a command accepts.

    Attributes:
        text: Description of the command.
        options: Options.
        values: Accepted arguments without a dash, if they can be listed.
        files: Whether files are accepted.
    """

    text: str
    options: Sequence[Option]
    values: Sequence[str]
    files: bool


def bash(commands: Mapping[str, CommandArguments]) -> Iterator[str]:
    """Yield a script for bash: `eval "$(mbd-ros completion bash)"`."""

    def offer(values: Sequence[str], files: bool) -> str:
        return f"words={quote(' '.join(values))} files={'1' if files else ''}"

    yield _BASH.replace("@TOP@", quote(" ".join((*commands, *_TOP))))
    yield from _cases(commands, offer)
    yield _BASH_END


def zsh(commands: Mapping[str, CommandArguments]) -> Iterator[str]:
    """Yield a script for zsh: `eval "$(mbd-ros completion zsh)"`, after compinit."""

    def offer(values: Sequence[str], files: bool) -> str:
        return f"compadd -- {join(values)}{'; _files' if files else ''}"

    yield _ZSH.replace("@TOP@", join((*commands, *_TOP)))
    yield from _cases(commands, offer)
    yield _ZSH_END


def fish(commands: Mapping[str, CommandArguments]) -> Iterator[str]:
    """Yield a script for fish: `mbd-ros completion fish | source`."""
    line = "complete -c mbd-ros"
    yield f"{line} -n __fish_use_subcommand -f -l version -d 'show version and exit'"
    for name, accepted in commands.items():
        yield f"{line} -n __fish_use_subcommand -f -a {name} -d {_fish(accepted.text)}"
        mine = f"{line} -n '__fish_seen_subcommand_from {name}'"
        files = "" if accepted.files else " -f"
        yield f"{mine}{files} -a {_fish(' '.join(accepted.values))}"
        for option in accepted.options:
            names = [f"-{'l' if n[1] == '-' else 's'} {n.lstrip('-')}" for n in option.names]
            value = f" -{'r' if option.files else 'x'} -a {_fish(' '.join(option.values))}"
            text = f" -d {_fish(option.text)}"
            yield f"{mine} {' '.join(names)}{value if option.takes else ''}{text}"


SHELLS: Mapping[str, Callable[[Mapping[str, CommandArguments]], Iterator[str]]] = {
    "bash": bash,
    "zsh": zsh,
    "fish": fish,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `completion`."""
    parser.add_argument("shell", choices=list(SHELLS), help="Shell that runs the script.")


def run(arguments: argparse.Namespace) -> int:
    """Print the script and return the exit code."""
    for line in SHELLS[arguments.shell](all_words()):
        sys.stdout.write(f"{line}\n")  # unchanged, since a shell reads it
    return OK


def all_words() -> Mapping[str, CommandArguments]:
    """Return the arguments of all commands; none for commands of other packages."""
    scenes = list(embedded_scenes())
    commands = {name: _arguments_of(name, scenes) for name in COMMANDS}
    return commands | {
        name: CommandArguments("", (), (), True)
        for name in added_commands()
        if name not in commands
    }


def _arguments_of(name: str, scenes: Sequence[str]) -> CommandArguments:
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
    return CommandArguments(COMMANDS[name].text, options, values, files)


def _cases(
    commands: Mapping[str, CommandArguments], offer: Callable[[Sequence[str], bool], str]
) -> Iterator[str]:
    """Yield cases by command and previous argument, in the common syntax of bash and zsh."""
    for name, accepted in commands.items():
        flags = [flag for option in accepted.options for flag in option.names]
        yield f"    {quote(name)}) case $before in"
        for option in accepted.options:
            if option.takes:
                yield f"      {'|'.join(option.names)}) {offer(option.values, option.files)} ;;"
        yield f"      *) if [[ $current == -* ]]; then {offer(flags, False)}"
        yield f"         else {offer(accepted.values, accepted.files)}; fi ;;"
        yield "      esac ;;"


def _fish(text: str) -> str:
    """Return a text quoted for fish."""
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"

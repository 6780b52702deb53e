"""Scripts that complete the words of `mbd-ros`, a function each shell: `mbd-ros completion`.

The words and their places are read from the parsers of the commands.
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
        values: Words without a dash, where they can be listed.
        files: Whether files may stand there.
    """

    text: str
    options: Sequence[Option]
    values: Sequence[str]
    files: bool


def bash(commands: Mapping[str, Words]) -> Iterator[str]:
    """For bash: `eval "$(mbd-ros completion bash)"`."""

    def offer(values: Sequence[str], files: bool) -> str:
        return f"words={quote(' '.join(values))} files={'1' if files else ''}"

    yield _BASH.replace("@TOP@", quote(" ".join((*commands, *_TOP))))
    yield from _cases(commands, offer)
    yield _BASH_END


def zsh(commands: Mapping[str, Words]) -> Iterator[str]:
    """For zsh: `eval "$(mbd-ros completion zsh)"`, after compinit."""

    def offer(values: Sequence[str], files: bool) -> str:
        return f"compadd -- {join(values)}{'; _files' if files else ''}"

    yield _ZSH.replace("@TOP@", join((*commands, *_TOP)))
    yield from _cases(commands, offer)
    yield _ZSH_END


def fish(commands: Mapping[str, Words]) -> Iterator[str]:
    """For fish: `mbd-ros completion fish | source`."""
    line = "complete -c mbd-ros"
    yield f"{line} -n __fish_use_subcommand -f -l version -d 'show version and exit'"
    for name, words in commands.items():
        yield f"{line} -n __fish_use_subcommand -f -a {name} -d {_fish(words.text)}"
        mine = f"{line} -n '__fish_seen_subcommand_from {name}'"
        files = "" if words.files else " -f"
        yield f"{mine}{files} -a {_fish(' '.join(words.values))}"
        for option in words.options:
            names = [f"-{'l' if n[1] == '-' else 's'} {n.lstrip('-')}" for n in option.names]
            value = f" -{'r' if option.files else 'x'} -a {_fish(' '.join(option.values))}"
            told = f" -d {_fish(option.text)}"
            yield f"{mine} {' '.join(names)}{value if option.takes else ''}{told}"


SHELLS: Mapping[str, Callable[[Mapping[str, Words]], Iterator[str]]] = {
    "bash": bash,
    "zsh": zsh,
    "fish": fish,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `completion` understands."""
    parser.add_argument("shell", choices=list(SHELLS), help="Whose language the script is in.")


def run(arguments: argparse.Namespace) -> int:
    """Print the script; the exit code."""
    for line in SHELLS[arguments.shell](all_words()):
        sys.stdout.write(f"{line}\n")  # whole, for a program
    return OK


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


def _cases(
    commands: Mapping[str, Words], offer: Callable[[Sequence[str], bool], str]
) -> Iterator[str]:
    """By command, and by the word before, in what bash and zsh have in common."""
    for name, words in commands.items():
        flags = [flag for option in words.options for flag in option.names]
        yield f"    {quote(name)}) case $before in"
        for option in words.options:
            if option.takes:
                yield f"      {'|'.join(option.names)}) {offer(option.values, option.files)} ;;"
        yield f"      *) if [[ $current == -* ]]; then {offer(flags, False)}"
        yield f"         else {offer(words.values, words.files)}; fi ;;"
        yield "      esac ;;"


def _fish(text: str) -> str:
    """Quoted as fish reads it."""
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"

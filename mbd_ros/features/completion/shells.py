"""Scripts that complete the words of `mbd-ros`, a function each shell."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from shlex import join, quote

from mbd_ros.features.completion.words import Words

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


def fish(commands: Mapping[str, Words]) -> Iterator[str]:
    """For fish: `mbd-ros completion fish | source`."""
    line = "complete -c mbd-ros"
    yield f"{line} -n __fish_use_subcommand -f -l version -d 'show it and exit'"
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


def _fish(text: str) -> str:
    """Quoted as fish reads it."""
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


SHELLS: Mapping[str, Callable[[Mapping[str, Words]], Iterator[str]]] = {
    "bash": bash,
    "zsh": zsh,
    "fish": fish,
}

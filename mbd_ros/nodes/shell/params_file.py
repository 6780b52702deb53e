"""Parameter files of nodes: how one is written, and faults that rcl accepts in silence."""

import math
import re
import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import yaml

from mbd_ros.errors import printable
from mbd_ros.nodes.shell.parameters import Parameter
from mbd_ros.regular_file import open_regular

_INDENT = "    "
_WIDTH = 99  # characters of a line


def lines(node: str, parameters: Sequence[Parameter]) -> Iterator[str]:
    """A file for --params-file that changes nothing; what must be given is commented out.

    Args:
        node: Name of the node.
        parameters: All that it has.
    """
    yield f"# Parameters of the node `{node}`. `/**` matches the node in every namespace."
    yield "/**:"
    yield "  ros__parameters:"
    for parameter in parameters:
        marked, required = f"{_INDENT}# ", parameter.default is None
        yield from textwrap.wrap(
            meaning(parameter) + " Required." * required,
            _WIDTH,
            initial_indent=marked,
            subsequent_indent=marked,
        )
        if required:
            placeholder = parameter.name.rpartition(".")[2].upper()
            yield f"{marked}{parameter.name}: {placeholder}"
        else:
            yield f"{_INDENT}{parameter.name}: {_written(parameter.default)}"


def meaning(parameter: Parameter) -> str:
    """Sentences on a parameter: what it means, what it takes, and when it may change."""
    sentences = [parameter.text]
    if parameter.choices:
        accepted = parameter.accepted()
        sentences.append(f"{accepted[0].upper()}{accepted[1:]}.")
    elif parameter.high < math.inf:
        sentences.append(f"From {parameter.low:g} to {parameter.high:g}.")
    elif parameter.low > -math.inf:
        sentences.append(f"At least {parameter.low:g}.")
    if not parameter.read_only:
        sentences.append("May change at run time.")
    return " ".join(sentences)


def _written(value: object) -> str:
    """A value as YAML in one line."""
    plain = list(value) if isinstance(value, tuple) else value
    text: str = yaml.safe_dump(plain, default_flow_style=True, width=10_000)
    return text.removesuffix("...\n").strip()


def parameter_files(argv: Sequence[str]) -> list[str]:
    """The files after --params-file on a command line."""
    return [value for flag, value in pairwise(argv) if flag == "--params-file"]


def file_warnings(argv: Sequence[str], node_name: str) -> list[str]:
    """Faults that rcl accepts in silence in the files after --params-file.

    Args:
        node_name: Fully qualified name of the node.

    Returns:
        A line per duplicate key (the last one wins), and per file of which no key is this node.
    """
    lines: list[str] = []
    for file in parameter_files(argv):
        try:
            with open_regular(file) as text:
                tree = yaml.compose(text, Loader=yaml.SafeLoader)
        except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
            lines.append(f"{file}: not checked for duplicate and unused keys: {error}")
            continue
        lines += [f"{file}: key '{key}' is given twice, the last wins" for key in _twice(tree)]
        keys = sorted(set(_node_keys(tree, "", set())))
        if not any(_matches(key, node_name) for key in keys):
            lines.append(
                f"{file}: no key is this node: the keys {', '.join(keys)} do not match; "
                f"accepted: {node_name} or /**"
            )
    return [printable(line) for line in lines]


def _entries(tree: Any) -> list[tuple[str, Any]]:
    """Keys that are texts, with the nodes that they name."""
    pairs = tree.value if isinstance(tree, yaml.MappingNode) else ()
    return [(key.value, value) for key, value in pairs if isinstance(key, yaml.ScalarNode)]


def _twice(tree: Any) -> Iterator[str]:
    """Keys that stand twice in a mapping; one that several aliases name is looked at once."""
    waiting, seen = [tree], {id(tree)}
    while waiting:
        entries = _entries(waiting.pop())
        counts = Counter(key for key, _ in entries)
        yield from (key for key, count in counts.items() if count > 1)
        waiting += [value for _, value in entries if id(value) not in seen]
        seen |= {id(value) for _, value in entries}


def _node_keys(tree: Any, path: str, seen: set[int]) -> Iterator[str]:
    seen.add(id(tree))
    for key, value in _entries(tree):
        if key == "ros__parameters":
            yield path
        elif id(value) not in seen:
            yield from _node_keys(value, f"{path}/{key.strip('/')}", seen)


def _matches(key: str, node_name: str) -> bool:
    pattern = re.escape(key).replace(r"/\*\*", "(/[^/]+)*").replace(r"/\*", "/[^/]+")
    return re.fullmatch(pattern, node_name) is not None

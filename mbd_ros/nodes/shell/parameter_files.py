"""Faults of parameter files that rcl accepts in silence: duplicate keys and keys of no node."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml


def file_warnings(argv: Sequence[str], node_name: str) -> list[str]:
    """Faults that rcl accepts in silence in the files after --params-file.

    Args:
        argv: Command line.
        node_name: Fully qualified name of the node.

    Returns:
        A line per duplicate key (the last one wins), and per file of which no key is this node.
    """
    files = [value for flag, value in pairwise(argv) if flag == "--params-file"]
    lines: list[str] = []
    for file in files:
        try:
            tree = yaml.compose(Path(file).read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
        except yaml.YAMLError as error:
            lines.append(f"{file}: not checked for duplicate and unused keys: {error}")
            continue
        lines += [f"{file}: key '{key}' is given twice, the last wins" for key in _twice(tree)]
        keys = sorted(set(_node_keys(tree, "")))
        if not any(_matches(key, node_name) for key in keys):
            lines.append(
                f"{file}: no key is this node: the keys {', '.join(keys)} do not match; "
                f"accepted: {node_name} or /**"
            )
    return lines


def _entries(tree: Any) -> Iterable[tuple[Any, Any]]:
    return tree.value if isinstance(tree, yaml.MappingNode) else ()


def _twice(tree: Any) -> Iterator[str]:
    counts = Counter(key.value for key, _ in _entries(tree))
    yield from (key for key, count in counts.items() if count > 1)
    for _, value in _entries(tree):
        yield from _twice(value)


def _node_keys(tree: Any, path: str) -> Iterator[str]:
    for key, value in _entries(tree):
        if key.value == "ros__parameters":
            yield path
        else:
            yield from _node_keys(value, f"{path}/{key.value.strip('/')}")


def _matches(key: str, node_name: str) -> bool:
    pattern = re.escape(key).replace(r"/\*\*", "(/[^/]+)*").replace(r"/\*", "/[^/]+")
    return re.fullmatch(pattern, node_name) is not None

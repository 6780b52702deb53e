"""YAML that means what it says: no duplicate keys, no tags, no aliases, numbers only as numbers.

Only the pattern of numbers below becomes a number: `1e-3` is 0.001, and `nan`, `1_000` or `0x10`
stay text, which the schema then refuses by key.
"""

import math
import os
import re
from pathlib import Path
from typing import Any

import yaml

from mbd_ros.errors import SceneError
from mbd_ros.regular_file import open_regular

MAX_BYTES = 1024 * 1024
MAX_DEPTH = 32
MAX_NODES = 200_000
# The parser of libyaml, ten times as fast, where there is one; nodes are composed in Python.
_BASES = (
    (yaml.composer.Composer, yaml.CSafeLoader) if yaml.__with_libyaml__ else (yaml.SafeLoader,)
)
_INTEGER = re.compile(r"[-+]?\d+", re.ASCII)
_FLOAT = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_WORDS = {"true": True, "false": False, "null": None, "~": None, "": None}


def read_text(path: Path, limit: int, what: str) -> str:
    """Contents of a UTF-8 file of at most `limit` bytes.

    Raises:
        SceneError: Missing, too large or not text; names the file.
    """
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            content = file.read(limit + 1)
        if size > limit or len(content) > limit:
            raise SceneError(f"{path}: {what} has {size} bytes, accepted are {limit}")
        return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: {what} is not UTF-8 text: {error.reason}") from error
    except OSError as error:
        raise SceneError(f"{path}: {what} cannot be read: {error.strerror}") from error


def read_mapping(path: Path, what: str = "scene file") -> dict[str, Any]:
    """The mapping that a YAML file holds.

    Args:
        what: What it is, for the messages.

    Raises:
        SceneError: Names file, line and key.
    """
    return mapping_of(read_text(path, MAX_BYTES, what), str(path))


def mapping_of(text: str, source: str) -> dict[str, Any]:
    """The mapping that YAML text holds.

    Args:
        source: Where it comes from, for the messages.

    Raises:
        SceneError: Names source, line and key.
    """
    try:
        node = _Composer(text).get_single_node()
    except yaml.YAMLError as error:
        raise SceneError(f"{source}: {_one_line(error)}") from error
    if node is None:
        raise SceneError(f"{source}: the file is empty")
    value = _value(node, source, "")
    if not isinstance(value, dict):
        raise SceneError(f"{source}: expected a mapping such as 'key: value'")
    return value


class _Composer(*_BASES):  # type: ignore[misc]
    """Composes nodes, refusing what a scene never needs; resolves no tags."""

    _depth = _nodes = 0

    def __init__(self, text: str) -> None:
        _BASES[-1].__init__(self, text)
        self.anchors: dict[str, Any] = {}

    def resolve(self, kind: Any, value: Any, implicit: Any) -> str:
        """No tag: `_scalar` decides what a word is."""
        return ""

    def descend_resolver(self, node: Any, index: Any) -> None:
        """Nothing to resolve."""

    def ascend_resolver(self) -> None:
        """Nothing to resolve."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()
        self._nodes += 1
        if self._nodes > MAX_NODES:
            self._refuse(f"more than {MAX_NODES} values", event)
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            self._refuse("anchors and aliases are refused", event)
        if getattr(event, "tag", None):
            self._refuse(f"tag {event.tag} is refused", event)
        if self._depth >= MAX_DEPTH:
            self._refuse(f"nested deeper than {MAX_DEPTH}", event)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def _refuse(self, problem: str, event: Any) -> None:
        raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)


def _one_line(error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    where = "" if mark is None else f"line {mark.line + 1}: "
    said = [getattr(error, name, None) for name in ("context", "problem")]
    return where + (", ".join(filter(None, said)) or str(error).splitlines()[0])


def _value(node: yaml.Node, source: str, key: str) -> Any:
    if isinstance(node, yaml.MappingNode):
        return _mapping(node, source, key)
    if isinstance(node, yaml.SequenceNode):
        return [_value(item, source, f"{key}[{i}]") for i, item in enumerate(node.value)]
    return _scalar(node, source, key)


def _mapping(node: yaml.MappingNode, source: str, path: str) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key_node, value_node in node.value:
        where = f"{source}: line {key_node.start_mark.line + 1}: "
        if not isinstance(key_node, yaml.ScalarNode):
            raise SceneError(f"{where}a key must be a word")
        key = key_node.value
        inner = f"{path}.{key}" if path else key
        if key in result:
            raise SceneError(f"{where}key '{inner}' is given twice")
        result[key] = _value(value_node, source, inner)
    return result


def _scalar(node: yaml.Node, source: str, key: str) -> Any:
    text = node.value
    if node.style:  # quoted: text on purpose
        return text
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text) and len(text) < 19:
        return int(text)
    if not _FLOAT.fullmatch(text):
        return text
    number = float(text)
    if math.isinf(number):
        raise SceneError(
            f"{source}: line {node.start_mark.line + 1}: {key}: {text} is not a finite number"
        )
    return number

"""The parameter file of a node: every parameter with its meaning, range and default."""

import math
import textwrap
from collections.abc import Iterator, Sequence

import yaml

from mbd_ros.nodes.shell.parameters import Parameter

_INDENT, _WIDTH = "    ", 99


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

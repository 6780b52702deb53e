"""Check of the graph of a learned network: plain operators on numbers in the same file.

An ONNX file can contain loops, functions, operators of other domains, and numbers in other files.
Networks of `mbd-ros learn` need none of these, so such files are rejected before they are loaded.

Source: onnx.proto3 of ONNX 1.17, whose field numbers are used here; the encoding of protobuf.
"""

from collections.abc import Iterator

from mbd_ros.errors import ModelError

OPERATORS = frozenset(
    {
        *("Add", "Concat", "Cos", "Div", "MatMul", "Mul", "ReduceMean", "Reshape", "Sin", "Sqrt"),
        *("Sub", "Tanh", "Transpose"),
    }
)
_GRAPH, _FUNCTION = 7, 25  # fields of a model
_NODE, _TENSOR, _SPARSE = 1, 5, 15  # of a graph
_OPERATOR, _DOMAIN = 4, 7  # of a node
_ELSEWHERE = (13, 14)  # of a tensor: location of numbers outside of it
_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5  # wire types
_LONGEST = 10  # bytes of a varint


def check_graph(name: str, content: bytes) -> None:
    """Check that a graph contains only plain operators and numbers.

    Args:
        name: Name of the file for messages.
        content: Bytes of the file.

    Raises:
        ModelError: It contains something else; the message names it.
    """
    try:
        for field, graph in _fields(content):
            if field == _FUNCTION:
                raise ModelError(
                    f"{name} has functions of its own, but only operators are accepted"
                )
            for inner, value in _fields(graph) if field == _GRAPH else ():
                if inner == _NODE:
                    _check_node(name, value)
                elif inner == _SPARSE or (
                    inner == _TENSOR and any(number in _ELSEWHERE for number, _ in _fields(value))
                ):
                    raise ModelError(f"{name} has numbers that are sparse or in another file")
    except (IndexError, ValueError) as error:
        raise ModelError(f"{name} is not a network in ONNX format: {error}") from error


def _check_node(name: str, node: bytes) -> None:
    texts = {field: text.decode(errors="replace") for field, text in _fields(node)}
    operator, domain = texts.get(_OPERATOR, ""), texts.get(_DOMAIN, "")
    if operator not in OPERATORS or domain:
        raise ModelError(
            f"{name}: the network cannot be evaluated: operator '{operator}'"
            f"{f' of {domain}' if domain else ''}, accepted: {', '.join(sorted(OPERATORS))}"
        )


def _fields(message: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield number and bytes of the fields of a message; plain numbers yield no bytes.

    Raises:
        ValueError: The message is truncated, or has another encoding.
        IndexError: The message ends within a number.
    """
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        size = 0
        wire_type = key & 7
        if wire_type == _VARINT:
            _, at = _varint(message, at)
        elif wire_type in (_EIGHT, _FOUR):
            at += 8 if wire_type == _EIGHT else 4
        elif wire_type == _BYTES:
            size, at = _varint(message, at)
        else:
            raise ValueError(f"a field has wire type {wire_type}")
        if at + size > len(message):
            raise ValueError("it is truncated")
        yield key >> 3, message[at : at + size]
        at += size


def _varint(message: bytes, at: int) -> tuple[int, int]:
    """Decode a number of seven bits a byte, lowest first, and return it with its end."""
    number = 0
    for i in range(_LONGEST):
        byte = message[at + i]
        number |= (byte & 0x7F) << (7 * i)
        if byte < 0x80:
            return number, at + i + 1
    raise ValueError("a number has more than ten bytes")

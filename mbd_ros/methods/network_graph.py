"""What the graph of a learned network may hold: plain operators on numbers of its own file.

An ONNX file may hold loops, functions, operators of other domains, and numbers that stand in
other files. Networks of `mbd-ros learn` need none of them, so they are refused before anything is
loaded.

Source: onnx.proto3 of ONNX 1.17, whose numbers of fields stand here; the encoding of protobuf.
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
_ELSEWHERE = (13, 14)  # of a tensor: where its numbers stand, when not in it
_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5  # ways of encoding
_LONGEST = 10  # bytes of a varint


def check_graph(name: str, content: bytes) -> None:
    """Refuse a graph with anything but plain operators and numbers.

    Args:
        name: Of the file, for the messages.

    Raises:
        ModelError: Names file, what is there and what is accepted.
    """
    try:
        for field, graph in _fields(content):
            if field == _FUNCTION:
                raise ModelError(f"{name}: has functions of its own, accepted are operators")
            for inner, value in _fields(graph) if field == _GRAPH else ():
                if inner == _NODE:
                    _check_node(name, value)
                elif inner == _SPARSE or (
                    inner == _TENSOR and any(number in _ELSEWHERE for number, _ in _fields(value))
                ):
                    raise ModelError(f"{name}: has numbers that are sparse or in another file")
    except (IndexError, ValueError) as error:
        raise ModelError(f"{name}: is no network of ONNX: {error}") from error


def _check_node(name: str, node: bytes) -> None:
    texts = {field: text.decode(errors="replace") for field, text in _fields(node)}
    operator, domain = texts.get(_OPERATOR, ""), texts.get(_DOMAIN, "")
    if operator not in OPERATORS or domain:
        raise ModelError(
            f"{name}: the network cannot be evaluated: operator '{operator}'"
            f"{f' of {domain}' if domain else ''}, accepted: {', '.join(sorted(OPERATORS))}"
        )


def _fields(message: bytes) -> Iterator[tuple[int, bytes]]:
    """Fields of a message in their order: number and bytes, which are empty of plain numbers.

    Raises:
        ValueError: The message is cut, or in another encoding.
        IndexError: It ends within a number.
    """
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        size = 0
        way = key & 7
        if way == _VARINT:
            _, at = _varint(message, at)
        elif way in (_EIGHT, _FOUR):
            at += 8 if way == _EIGHT else 4
        elif way == _BYTES:
            size, at = _varint(message, at)
        else:
            raise ValueError(f"a field is encoded as {way}")
        if at + size > len(message):
            raise ValueError("it is cut")
        yield key >> 3, message[at : at + size]
        at += size


def _varint(message: bytes, at: int) -> tuple[int, int]:
    """A number of seven bits a byte, the lowest first, and where it ends."""
    number = 0
    for i in range(_LONGEST):
        byte = message[at + i]
        number |= (byte & 0x7F) << (7 * i)
        if byte < 0x80:
            return number, at + i + 1
    raise ValueError("a number has more than ten bytes")

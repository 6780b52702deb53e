"""C source of functions, as it is compiled."""

from typing import NamedTuple


class Signature(NamedTuple):
    """Sizes of the arguments and results of a function, in their order, as dense columns."""

    arguments: tuple[int, ...]
    results: tuple[int, ...]
    work: int


class Source(NamedTuple):
    """C source of functions.

    For each function there is `static void NAME(const real *restrict i0, .., real *restrict o0,
    .., real *restrict work)`, one pointer an argument and then a result, all of them dense
    columns; `NAME_WORK` is how many reals `work` has to hold. `call_NAME(at)` is the same, from
    outside, with an array of the pointers.

    Attributes:
        units: Other sources that belong to it: of long functions, to be compiled side by side.
        lanes: How many numbers a real is.
        operations: Function -> how many values it computes.
        signatures: Function -> sizes.
    """

    text: str
    units: tuple[str, ...]
    lanes: int
    operations: dict[str, int]
    signatures: dict[str, Signature]

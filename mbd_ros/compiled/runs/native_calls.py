"""The functions of a library that take runs, as ctypes calls them."""

import ctypes
from typing import Any


def bound(c: Any) -> Any:
    """The functions of a library with the types of their arguments."""
    pointer, number, whole = ctypes.c_void_p, ctypes.c_double, ctypes.c_long
    for name, arguments in (
        ("restart", (pointer,)),
        ("leave", (pointer,)),
        ("touch", (pointer,)),
        ("place_of", (whole,)),
        ("sample_from", (*(pointer,) * 5, whole, pointer, pointer)),
        ("advance", (pointer, pointer, pointer, number, whole)),
        ("samples", (*(pointer,) * 4, number, whole, whole, pointer, pointer)),
        ("evaluate_at", (pointer, pointer, number, pointer, pointer, pointer)),
        ("again", (pointer, pointer, number, number, pointer)),
        ("step_alone", (pointer, pointer, pointer, number)),
        ("state_within", (pointer, pointer, number, pointer)),
        ("margin_within", (pointer, pointer, number, whole)),
        ("margin_again", (pointer, pointer, number, number, whole)),
        ("first_event", (pointer,) * 4),
        ("interpolate", (pointer, pointer, number, pointer)),
    ):
        getattr(c, name).argtypes = arguments
    c.place_of.restype = whole
    for name in ("evaluate_at", "margin_within", "margin_again", "first_event"):
        getattr(c, name).restype = number
    for name in ("restart", "leave", "touch"):
        getattr(c, name).restype = None
    return c

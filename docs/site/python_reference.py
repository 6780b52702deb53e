"""The page of the Python interface: directives that have Sphinx read the docstrings."""

import mbd_ros

CONTRACTS = {
    "Parts": (
        "mbd_ros.core.contracts",
        "mbd_ros.core.rows.constraint",
    ),
    "Values": ("mbd_ros.core.state",),
    "What parts ask": ("mbd_ros.core.kinematics.kinematics",),
    "Control laws": ("mbd_ros.methods.control.contract",),
    "Ranges and units of arguments": ("mbd_ros.core.ranges",),
    "Errors": ("mbd_ros.errors",),
}
_HEAD = """\
# Python interface

Made from docstrings by `make docs`. [python.md](python.md) shows how it is used.

## import mbd_ros as mbd

"""
_OF_PARTS = "What parts of your own derive from and call; [extend.md](extend.md) has examples.\n\n"


def page() -> str:
    """The page as Markdown."""
    names = [name for name in mbd_ros.__all__ if name not in ("__version__", "MbdError")]
    return _HEAD + _rst(map(_public, names)) + "\n" + _OF_PARTS.join(("", _contracts()))


def _contracts() -> str:
    return "\n".join(
        f"## {title}\n\n" + _rst(f".. automodule:: {name}\n   :members:\n" for name in modules)
        for title, modules in CONTRACTS.items()
    )


def _public(name: str) -> str:
    found = getattr(mbd_ros, name)
    home = f"{found.__module__}.{found.__name__}"
    if not isinstance(found, type):
        return f".. autofunction:: {home}\n"
    return f".. autoclass:: {home}\n   :members:\n   :inherited-members: Mapping, Exception\n"


def _rst(directives: object) -> str:
    lines = "\n".join(directives)  # type: ignore[call-overload]
    return f"```{{eval-rst}}\n{lines}```\n"

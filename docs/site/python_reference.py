"""Generate the reference of the Python interface: directives that make Sphinx read docstrings."""

import mbd_ros

CONTRACTS = {
    "Parts": (
        "mbd_ros.core.contracts",
        "mbd_ros.core.rows.constraint",
    ),
    "Values": ("mbd_ros.core.state",),
    "Kinematics for parts": ("mbd_ros.core.kinematics.kinematics",),
    "Control laws": ("mbd_ros.methods.control.contract",),
    "Ranges and units of arguments": ("mbd_ros.core.ranges",),
    "Errors": ("mbd_ros.errors",),
}
_HEAD = """\
# Python interface

With this page you can look up every public class and function of Python. `make docs` generates it
from docstrings; [python.md](python.md) has examples.

## import mbd_ros as mbd

"""
_OF_PARTS = "Base classes for parts of your own; [extend.md](extend.md) has examples.\n\n"


def page() -> str:
    """Return the page as Markdown."""
    names = [name for name in mbd_ros.__all__ if name not in ("__version__", "MbdError")]
    return _HEAD + _rst(map(_public, names)) + "\n" + _OF_PARTS + _contracts()


def _contracts() -> str:
    return "\n".join(
        f"## {title}\n\n" + _rst(f".. automodule:: {name}\n   :members:\n" for name in modules)
        for title, modules in CONTRACTS.items()
    )


def _public(name: str) -> str:
    value = getattr(mbd_ros, name)
    home = f"{value.__module__}.{value.__name__}"
    if not isinstance(value, type):
        return f".. autofunction:: {home}\n"
    return f".. autoclass:: {home}\n   :members:\n   :inherited-members: Mapping, Exception\n"


def _rst(directives: object) -> str:
    lines = "\n".join(directives)  # type: ignore[call-overload]
    return f"```{{eval-rst}}\n{lines}```\n"

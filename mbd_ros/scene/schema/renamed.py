"""Names of earlier versions, so that an error tells the new one."""

import re
from collections.abc import Iterable, Mapping, Sequence

RENAMED: Mapping[str, Mapping[str, str]] = {  # kind -> old name -> new name
    "column": {},  # the quantity, after the last dot
    "command": {},
    "option": {},
    "parameter": {},
    "topic": {},
}


_OLD_ROWS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    # last word of an old row -> types of its part, and quantities of its multiplier
    **{axis: (("loop_closure", "frame_anchor"), (f"force_{axis}",)) for axis in "xyz"},
    **{f"r{axis}": (("loop_closure", "frame_anchor"), (f"torque_{axis}",)) for axis in "xyz"},
    "distance": (("distance",), ("force",)),
    "normal": (("point_on_plane",), ("force",)),
    "screw": (("screw",), ("force",)),
    "stop": (("joint_stop",), ("torque", "force")),
    "friction": (("dry_friction",), ("torque", "force")),
    "motion": (("prescribed_motion",), ("torque", "force")),
}
_KINDS = {kind for kinds, _ in _OLD_ROWS.values() for kind in kinds}
_OLD_MULTIPLIER = re.compile(r"(?:(.+)\.(\w+)(?:#\d+)?\.)?multiplier")


def renamed(kind: str, name: str, existing: Iterable[str] = ()) -> str:
    """Hint for a message about a name that does not exist.

    Args:
        kind: A key of `RENAMED`.
        name: As it was given.
        existing: Names of columns, to find the new one of a multiplier among them.

    Returns:
        `; <name> is called <new name> now`, or nothing where it never had another name.
    """
    if kind == "column" and (old_row := _OLD_MULTIPLIER.fullmatch(name)):
        found = _multipliers(*old_row.groups(), tuple(existing))
        now = f"one of {', '.join(found)}" if len(found) > 1 else "".join(found)
        return f"; {name} is called {now or '<part>.<quantity>, such as bar_distance.force,'} now"
    for old, new in RENAMED[kind].items():
        if kind == "column" and name.endswith(f".{old}"):
            now = name.removesuffix(old) + new
        elif name == old:
            now = new
        else:
            continue
        return f"; {name} is called {now} now"
    return ""


def _multipliers(place: str | None, word: str | None, existing: Sequence[str]) -> list[str]:
    """Columns of an old row: those of a part named by default at its place, else all alike."""
    if place is None or word not in _OLD_ROWS:
        return []
    kinds, quantities = _OLD_ROWS[word]
    quantities += tuple(f"{quantity}_{place}" for quantity in quantities)
    alike = [name for name in existing if name.rpartition(".")[2] in quantities]
    ends = [
        (name, end)
        for name in alike
        for kind in kinds
        for end in re.findall(rf"^(?:(.*)_)?{kind}(?:_\d+)?\.", name)
    ]
    there = [n for n, end in ends if not end or end in (place, *place.split("-"))]
    typed = re.compile("|".join(rf"(?:.*_)?{k}(?:_\d+)?\..*" for k in _KINDS))
    return there or [name for name in alike if not typed.fullmatch(name)]

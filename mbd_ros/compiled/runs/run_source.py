"""The C source of a whole run: functions of a scene, then the integrators over them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from mbd_ros.compiled.code.source import Source

NATIVE = Path(__file__).parents[1] / "native"
_FILES = (
    "run.h",
    "weights.h",
    "runge_kutta.h",
    "adams.h",
    "projection.h",
    "rattle.h",
    "steps.h",
    "events.h",
)
_LAST = {False: ("run.c", "search.c"), True: ("lanes.c",)}  # by whether reals are several numbers


def with_integrators(functions: Source, sizes: Sizes) -> Source:
    """The source of a library that takes whole runs.

    Args:
        functions: What `emit` made of `Sizes.functions`; of vectors for runs side by side.
    """
    work = max(one.work for one in functions.signatures.values())
    numbers = {
        **{name.upper(): int(value) for name, value in sizes._asdict().items()},
        "WORK": work,
    }
    files = (*_FILES, *_LAST[functions.lanes > 1])
    lines = [f"#define {name} {value}\n" for name, value in numbers.items()]
    texts = [(NATIVE / name).read_text(encoding="utf-8") for name in files]
    return functions._replace(text="".join((functions.text, *lines, *texts)))


class Sizes(NamedTuple):
    """What the integrators are compiled for, as `native/run.h` names it.

    Attributes:
        nq: Size of a configuration of what is integrated.
        nv: Of its velocity.
        nz: Internal states.
        nu: Inputs.
        ng: Rows of positions.
        nh: Rows that velocities keep.
        nq_all: Size of a configuration of all joints.
        nv_all: Of their velocity.
        is_flat: Whether configurations are a vector space with q' = v.
        is_whole: Whether all joints are integrated.
        is_projected: Whether every step is followed by a projection onto the rows.
        is_rattle: Whether the method is RATTLE.
        np: Parameters.
        modes: Unilateral rows, whose modes stand behind the parameters.
        answers: Margins of their forces.
        gaps: How many of them are gaps.
        stays: How many have a rate that is none where they are on.
        contacts: How many of them are normals of contacts with friction.
        has_demands: Whether some of them are drives, whose demands are looked at in any mode.
        asks_always: Whether accelerations are, for these or for the rates of slips.
    """

    nq: int
    nv: int
    nz: int
    nu: int
    ng: int
    nh: int
    nq_all: int
    nv_all: int
    is_flat: bool
    is_whole: bool
    is_projected: bool = False
    is_rattle: bool = False
    np: int = 0
    modes: int = 0
    answers: int = 0
    gaps: int = 0
    stays: int = 0
    contacts: int = 0
    has_demands: bool = False
    asks_always: bool = False

    @property
    def functions(self) -> tuple[str, ...]:
        """The functions that the integrators call, by the names of `Traced`."""
        names = ["accelerate"]
        if not self.is_flat:
            names += ["integrate", "rate"]
        if not self.is_whole:
            names.append("expand")
        if self.is_projected and self.ng:
            names.append("place")
        if self.is_rattle and self.ng:
            names += ["gap", "lift"]
        if (self.is_projected or self.is_rattle) and self.nh:
            names.append("settle")
        if self.modes:
            names += ["heights", "answers"]
        names += ["land"] * bool(self.gaps) + ["stay"] * bool(self.stays)
        return tuple(names)

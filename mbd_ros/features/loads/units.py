"""Systems of units of loads and meshes; forces are newtons and times seconds in each."""

from __future__ import annotations

from typing import NamedTuple

from mbd_ros.errors import DataError


def units_of(name: str) -> Units:
    """The system of a name.

    Raises:
        DataError: There is none.
    """
    if name not in SYSTEMS:
        raise DataError(f"--units {name}: accepted: m (N, m, kg, s, Pa) and mm (N, mm, t, s, MPa)")
    return SYSTEMS[name]


class Units(NamedTuple):
    """A consistent system of units.

    Attributes:
        name: Of its length.
        per_metre: Its lengths in a metre.
        mass: Of its masses.
        stress: Of its stresses.
    """

    name: str
    per_metre: float
    mass: str
    stress: str

    @property
    def moment(self) -> str:
        """Of its moments."""
        return f"N·{self.name}"

    @property
    def acceleration(self) -> str:
        """Of its accelerations."""
        return f"{self.name}/s^2"


SYSTEMS = {"m": Units("m", 1.0, "kg", "Pa"), "mm": Units("mm", 1000.0, "t", "MPa")}

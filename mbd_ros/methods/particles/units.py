"""Units of a scene of particles, with the physical constants in these units.

The numbers of a scene are used without conversion. Units of energy, force and so on follow from
length, time and mass; charges are in elementary charges, in SI units in coulomb.
"""

from typing import NamedTuple

ANGSTROM, NANOMETRE, PICOSECOND = 1.0e-10, 1.0e-9, 1.0e-12  # in SI
AMU = 1.66053906660e-27  # kg
CHARGE = 1.602176634e-19  # C
BOLTZMANN = 1.380649e-23  # J/K
COULOMB = 8.9875517923e9  # N m^2/C^2


class Units(NamedTuple):
    """Units of length, time and mass.

    Attributes:
        name: Name of the units in a scene.
        symbols: Symbols of length, time, mass and temperature, for columns.
        sizes: Length, time and mass in SI; empty for reduced units, which have none.
        boltzmann: Boltzmann's constant in these units.
        coulomb: Coulomb's constant in these units.

    Source: CODATA 2018.
    """

    name: str
    symbols: tuple[str, str, str, str]
    sizes: tuple[float, ...]
    boltzmann: float
    coulomb: float

    @property
    def length(self) -> str:
        """Symbol of a length."""
        return self.symbols[0]

    @property
    def time(self) -> str:
        """Symbol of a time."""
        return self.symbols[1]

    @property
    def velocity(self) -> str:
        """Symbol of a velocity."""
        return self._symbol("velocity", f"{self.length}/{self.time}")

    @property
    def force(self) -> str:
        """Symbol of a force."""
        return self._symbol("force", f"{self.symbols[2]} {self.length}/{self.time}^2", "N")

    @property
    def energy(self) -> str:
        """Symbol of an energy."""
        return self._symbol("energy", f"{self.symbols[2]} {self.length}^2/{self.time}^2", "J")

    def _symbol(self, reduced: str, composed: str, si: str = "m/s") -> str:
        if not self.sizes:
            return f"reduced {reduced}"
        return si if self.name == "si" else composed


def _derived(name: str, symbols: tuple[str, str, str, str], *sizes: float, charge: float) -> Units:
    length, time, mass = sizes
    energy = mass * length**2 / time**2
    coulomb = COULOMB * charge**2 / (energy * length)
    return Units(name, symbols, sizes, BOLTZMANN / energy, coulomb)


SI = _derived("si", ("m", "s", "kg", "K"), 1.0, 1.0, 1.0, charge=1.0)
MOLECULAR = _derived(
    "molecular",
    ("angstrom", "ps", "amu", "K"),
    *(ANGSTROM, PICOSECOND, AMU),
    charge=CHARGE,
)
REDUCED = Units("reduced", ("reduced length", "reduced time", "reduced mass", "-"), (), 1.0, 1.0)
UNITS = {units.name: units for units in (SI, MOLECULAR, REDUCED)}

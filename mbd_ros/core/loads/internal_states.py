"""z: the internal states of the parts of a system, where each stands, and their rates."""

import math
from collections.abc import Sequence

import numpy as np

from mbd_ros.core.contracts import Internal, Part
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.errors import ModelError


class Internals:
    """The internal states of parts.

    Args:
        parts: Parts that know where their internal states stand; those without any are left out.

    Attributes:
        parts: Those that have any.
        nz: How many there are.
        names: `<part>`, or `<part>.<name>` where a part names them, in the order of z.
        units: In the same order.
        lower: Smallest values, -inf without, shape (nz,).
        upper: Largest values, inf without, shape (nz,).
        initial: Values at the start, shape (nz,), NaN for the equilibrium.
        is_constant: Whether all rates are always 0.
        reads: What the rates read of k.

    Raises:
        ModelError: Two parts stand at the same place, since nobody has bound them; two states
            have one name; or a state starts outside its bounds.
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = tuple(part for part in parts if part.internal)
        self.reads = max((part.reads for part in self.parts), default=Reads.NOTHING)
        found: dict[int, tuple[str, Internal]] = {}
        for part in self.parts:
            for i, one in enumerate(part.internal, part.z.start or 0):
                if i in found:
                    raise ModelError(
                        f"{part.name} and {found[i][0]} share an internal state; bind their slots"
                    )
                found[i] = ".".join(filter(None, (part.name, one.name))), one
        self.nz = max(found, default=-1) + 1
        names = [name for name, _ in found.values()]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ModelError(f"internal states must differ by name: {', '.join(repeated)} repeats")
        absent = "", Internal("", "", initial=0.0)
        every = [found.get(i, absent) for i in range(self.nz)]
        self.names = tuple(name for name, _ in every)
        self.units = tuple(one.unit for _, one in every)
        self.lower = np.array([one.lower for _, one in every], dtype=np.float64)
        self.upper = np.array([one.upper for _, one in every], dtype=np.float64)
        for name, one in every:
            first = one.lower if one.initial is None else one.initial
            if not one.lower <= first <= one.upper:
                raise ModelError(
                    f"{name} starts at {first:g}, outside {one.lower:g} .. {one.upper:g}"
                )
        given = (one.initial for _, one in every)
        self.initial = np.array([math.nan if v is None else v for v in given], dtype=np.float64)
        self.is_constant = all(one.is_constant for _, one in every)
        self._is_bounded = bool(np.isfinite([self.lower, self.upper]).any())

    def inside(self, z: Array) -> Array:
        """The nearest values within the bounds, z itself where there are none."""
        if not self._is_bounded:
            return z
        return np.minimum(np.maximum(z, self.lower), self.upper)

    def completed(self, z: Array) -> Array:
        """Values at the start: those given, `initial` where none is; NaN for the equilibrium.

        Args:
            z: Shape (nz,), NaN where nothing is given, or (0,).

        Raises:
            ModelError: Another size, or a value beyond its bounds; names it.
        """
        if not len(z):
            return self.initial.copy()
        self.check(z)
        for i, value in enumerate(z.tolist()):
            if not math.isnan(value) and not self.lower[i] <= value <= self.upper[i]:
                raise ModelError(
                    f"{self.names[i]} {value:g} starts outside its bounds, {self.lower[i]:g} .. "
                    f"{self.upper[i]:g} {self.units[i]}".rstrip()
                )
        return np.where(np.isnan(z), self.initial, z)

    def at_rest(self, k: Kinematics, x: State, u: Array) -> Array:
        """Internal states with what parts know of their equilibrium, fresh, shape (nz,).

        Args:
            x: State of all joints; z is NaN where nothing is given.
        """
        z = x.z.copy()
        for part in self.parts:
            found = part.at_rest(k, x, u) if np.isnan(z[part.z]).any() else None
            if found is not None:
                z[part.z] = found
        return z

    def check(self, z: Array) -> None:
        """Refuse internal states of another scene."""
        if len(z) != self.nz:
            names = ", ".join(filter(None, self.names))
            raise ModelError(
                f"the state has {len(z)} internal states, the scene has {self.nz}: {names}; "
                "Simulation.start finds them"
            )

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Rates of all internal states, fresh, shape (nz,).

        Args:
            x: State of all joints, internal states inside their bounds.
        """
        if not self.nz:
            return NONE
        found = np.zeros(self.nz)
        for part in self.parts:
            found[part.z] = part.rates(k, x, u)
        return found

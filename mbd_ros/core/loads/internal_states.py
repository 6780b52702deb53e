"""Internal states z of the parts of a system, and their rates."""

import math
from collections.abc import Sequence

import numpy as np

from mbd_ros.core.contracts import Internal, Part
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.errors import ModelError


class Internals:
    """Internal states of all parts, such as activations and motor speeds.

    Args:
        parts: Parts that are bound to their slots of z; parts without internal states are ignored.

    Attributes:
        parts: Parts with internal states.
        nz: Number of internal states.
        names: `<part>`, or `<part>.<name>` if the state has a name, in the order of z.
        units: Units in the same order.
        lower: Lower bounds, -inf for none, shape (nz,).
        upper: Upper bounds, inf for none, shape (nz,).
        initial: Initial values, shape (nz,), NaN for the equilibrium.
        is_constant: Whether all rates are always 0.
        reads: Level of k that the rates read.

    Raises:
        ModelError: Two parts share a slot, since they were not bound; two states have the same
            name; or an initial value is outside of its bounds.
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = tuple(part for part in parts if part.internal)
        self.reads = max((part.reads for part in self.parts), default=Reads.NOTHING)
        slots: dict[int, tuple[str, Internal]] = {}
        for part in self.parts:
            for i, state in enumerate(part.internal, part.z.start or 0):
                if i in slots:
                    raise ModelError(
                        f"{part.name} and {slots[i][0]} share an internal state; bind their slots"
                    )
                slots[i] = ".".join(filter(None, (part.name, state.name))), state
        self.nz = max(slots, default=-1) + 1
        names = [name for name, _ in slots.values()]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ModelError(f"two internal states have the same name: {', '.join(repeated)}")
        absent = "", Internal("", "", initial=0.0)
        states = [slots.get(i, absent) for i in range(self.nz)]
        self.names = tuple(name for name, _ in states)
        self.units = tuple(state.unit for _, state in states)
        self.lower = np.array([state.lower for _, state in states], dtype=np.float64)
        self.upper = np.array([state.upper for _, state in states], dtype=np.float64)
        for name, state in states:
            first = state.lower if state.initial is None else state.initial
            if not state.lower <= first <= state.upper:
                raise ModelError(
                    f"{name} starts at {first:g}, outside {state.lower:g} .. {state.upper:g}"
                )
        initial = (state.initial for _, state in states)
        self.initial = np.array([math.nan if v is None else v for v in initial], dtype=np.float64)
        self.is_constant = all(state.is_constant for _, state in states)
        self._is_bounded = bool(np.isfinite([self.lower, self.upper]).any())

    def inside(self, z: Array) -> Array:
        """Return z clipped to its bounds, or z itself if there are no bounds."""
        if not self._is_bounded:
            return z
        return np.minimum(np.maximum(z, self.lower), self.upper)

    def completed(self, z: Array) -> Array:
        """Complete initial values by `initial`; NaN stands for the equilibrium.

        Args:
            z: Initial values, shape (nz,), NaN for those to complete; or shape (0,).

        Raises:
            ModelError: z has another size, or a value is outside of its bounds.
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
        """Return z with equilibrium values where parts know them, a new array, shape (nz,).

        Args:
            k: Kinematics at the state.
            x: State of all joints; z is NaN where the equilibrium is sought.
            u: All inputs.
        """
        z = x.z.copy()
        for part in self.parts:
            equilibrium = part.at_rest(k, x, u) if np.isnan(z[part.z]).any() else None
            if equilibrium is not None:
                z[part.z] = equilibrium
        return z

    def check(self, z: Array) -> None:
        """Raise a ModelError if z has another size than the internal states of the scene."""
        if len(z) != self.nz:
            names = ", ".join(filter(None, self.names))
            raise ModelError(
                f"the state has {len(z)} internal states, but the scene has {self.nz}: {names}; "
                "Simulation.start computes them"
            )

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the rates of all internal states, a new array, shape (nz,).

        Args:
            k: Kinematics at the state.
            x: State of all joints, with internal states inside their bounds.
            u: All inputs.
        """
        if not self.nz:
            return NONE
        rates = np.zeros(self.nz)
        for part in self.parts:
            rates[part.z] = part.rates(k, x, u)
        return rates

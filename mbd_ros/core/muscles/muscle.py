"""Muscles of all types: a load along a path, with activation and fibre length as states."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from mbd_ros.core.contracts import Actuator, Channel, Internal, Now, Output, Value
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.loads.path_load import PathLoad
from mbd_ros.core.muscles.contraction import Contraction, Fiber, stable_lengths
from mbd_ros.core.muscles.curves import ArrayNumbers
from mbd_ros.core.muscles.metabolic_rate import USUAL_METABOLISM, Metabolism, metabolic_rate
from mbd_ros.core.state import Array, State

_OUTPUTS = (
    Output("tension", "N"),
    Output("length", "m"),
    Output("fiber_velocity", "m/s"),
    Output("active_force", "N"),
    Output("passive_force", "N"),
    Output("fiber_power", "W"),
    Output("damping_loss", "W"),
)
Number = Any  # float, symbol or array
_LEAST, _MORE = 0.5, 1.5  # of the factor of both time constants


class Muscle(PathLoad, Actuator):
    """A muscle along a path: an actuator of no joint, whose command is its excitation.

    Args:
        contraction: Fibres and tendon.
        dynamics: How activation follows excitation.
        tendon: `elastic` or `rigid`.
    """

    joints = ()
    takes = "excitation of the muscle [-]"

    has_metabolic_rate = True

    def __init__(
        self, path: Path, contraction: Contraction, dynamics: ActivationDynamics, tendon: str
    ) -> None:
        super().__init__(path)
        self.contraction = contraction
        self.dynamics = dynamics
        self.tendon = tendon
        self.inputs = (Channel("excitation", "-", dynamics.least, 1.0, dynamics.least),)
        states = [Internal("activation", "-", dynamics.least, 1.0)]
        if self.is_elastic:
            shortest = contraction.pennation.shortest
            states.append(Internal("fiber_length", "m", shortest, math.inf))
        self.internal = tuple(states)
        self.outputs = _OUTPUTS if self.is_elastic else (*_OUTPUTS, Output("fiber_length", "m"))

    @property
    def is_elastic(self) -> bool:
        """Whether the tendon is elastic."""
        return self.tendon == "elastic"

    def tension(self, k: Kinematics, x: State, u: Array, length: float, speed: float) -> float:
        """Force of the tendon [N]."""
        activation, fiber_length = self._states(k, x)
        if self.is_elastic:
            return self.contraction.tendon(k, length, fiber_length)
        return self.contraction.rigid_tension(k, activation, length, speed)

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Rates of activation and fibre length [1/s, m/s]."""
        activation, fiber_length = self._states(k, x)
        rate = self.dynamics.rate(k, k.item(u, self.u.start or 0), activation)
        if not self.is_elastic:
            return k.array([rate])
        length = self.path.length(k, x)
        fiber = self.contraction.beside_elastic_tendon(k, activation, length, fiber_length)
        return k.array([rate, fiber.velocity])

    def balance(self, k: Kinematics, x: State, u: Array, w: Array) -> Array:
        """What is zero at rates w: fibres against tendon, in peak forces times largest speeds."""
        activation, fiber_length = self._states(k, x)
        off = k.item(w, 0) - self.dynamics.rate(k, k.item(u, self.u.start or 0), activation)
        if not self.is_elastic:
            return k.array([off])
        length, speed = self.path.length(k, x), k.item(w, 1)
        lacking = self.contraction.lacking(k, activation, length, fiber_length, speed)
        return k.array([off, self.contraction.fastest * lacking])

    def at_rest(self, k: Kinematics, x: State, u: Array) -> Array | None:
        """Activation and fibre length at rest; of several stable lengths the shortest one."""
        found = x.z[self.z].copy()
        found[0] = self._first_activation(x, u)
        if self.is_elastic and math.isnan(found[1]):
            found[1] = self.stable_lengths(found[0], self.path.length(k, x))[0]
        return found

    def choices_at_rest(self, k: Kinematics, x: State, u: Array) -> list[float]:
        """Stable fibre lengths among which `at_rest` chooses [m]; empty where there is no choice.

        Args:
            x: State of all joints, z NaN where nothing is given.
        """
        if not self.is_elastic or not math.isnan(x.z[self.z][1]):
            return []
        found = self.stable_lengths(self._first_activation(x, u), self.path.length(k, x))
        return found if len(found) > 1 else []

    def stable_lengths(self, activation: float, length: float) -> list[float]:
        """Fibre lengths at which the muscle may rest, the shortest one first [m].

        Args:
            activation: From its least value to 1.
            length: Of the path [m].
        """
        return stable_lengths(self.contraction, activation, length)

    def command(self, torque: Array, x: State) -> Array:
        """The least excitation, shape (1,): no torque of a joint is asked of a muscle alone."""
        return np.full(1, self.inputs[0].safe)

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of tendon and passive fibres [J]."""
        length, fiber_length = self.path.length(k, x), self._states(k, x)[1]
        if self.is_elastic:
            energy = self.contraction.tendon_energy(k, length, fiber_length)
            return energy + self.contraction.fiber_energy(k, fiber_length)
        fiber = self.contraction.beside_rigid_tendon(k, length, 0.0)
        return self.contraction.fiber_energy(k, fiber.length)

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """Zeros, shape (nv, 1): an excitation reaches the joints through the activation alone."""
        return np.zeros((len(x.v), 1))

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Forces, fibres and powers; `fiber_power` is what active fibres give, positive."""
        activation, _ = self._states(k, x)
        length, slope = self.path.measured(k, x)
        speed = k.dot(slope, x.v)
        fiber = self._fiber(k, x, length, speed)
        active = self.contraction.active(k, activation, fiber)
        damping = self.contraction.damping(fiber)
        shown = (
            self.tension(k, x, u, length, speed),
            length,
            fiber.velocity,
            active,
            self.contraction.passive(k, fiber),
            -active * fiber.velocity,
            damping * fiber.velocity,
        )
        return shown if self.is_elastic else (*shown, fiber.length)

    def metabolic_rate(
        self, k: Kinematics, x: State, u: Array, numbers: Metabolism = USUAL_METABOLISM
    ) -> float:
        """What the muscle takes from food [W], see `metabolic_rate`.

        Args:
            numbers: Of its fibres.
        """
        activation, _ = self._states(k, x)
        length, slope = self.path.measured(k, x)
        fiber = self._fiber(k, x, length, k.dot(slope, x.v))
        excitation = k.item(u, self.u.start or 0)
        rate: float = metabolic_rate(k, self.contraction, activation, excitation, fiber, numbers)
        return rate

    def active_force(self, length: Array, speed: Array) -> Array:
        """Force along the tendon of the fully active fibres beside a rigid tendon [N].

        The force at activation a is a times it, but for `thelen`, whose force-velocity curve
        depends on a.

        Args:
            length: Of the path [m], any shape.
            speed: Its rate [m/s], same shape.
        """
        fiber = self.contraction.beside_rigid_tendon(ArrayNumbers, length, speed)
        found: Array = self.contraction.active(ArrayNumbers, 1.0, fiber) * fiber.cosine
        return found

    def passive_force(self, length: Array) -> Array:
        """Elastic force of the fibres along a rigid tendon [N], as `active_force`."""
        fiber = self.contraction.beside_rigid_tendon(ArrayNumbers, length, 0.0 * length)
        found: Array = self.contraction.passive(ArrayNumbers, fiber) * fiber.cosine
        return found

    def fiber_length(self, length: Array) -> Array:
        """Fibre length beside a rigid tendon [m], as `active_force`."""
        found: Array = self.contraction.pennation.fiber(
            ArrayNumbers, length - self.contraction.slack
        )
        return found

    def fiber_velocity(self, length: Array, speed: Array) -> Array:
        """Rate of the fibre length beside a rigid tendon [m/s], as `active_force`."""
        found: Array = self.contraction.beside_rigid_tendon(ArrayNumbers, length, speed).velocity
        return found

    def _first_activation(self, x: State, u: Array) -> float:
        """As given, or that of the excitation at rest."""
        given = float(x.z[self.z][0])
        return min(max(u[self.u].item(), self.dynamics.least), 1.0) if math.isnan(given) else given

    def _states(self, k: Kinematics, x: State) -> tuple[float, float]:
        """Activation and fibre length; the latter 0 beside a rigid tendon."""
        first = self.z.start or 0
        return k.item(x.z, first), k.item(x.z, first + 1) if self.is_elastic else 0.0

    def _fiber(self, k: Kinematics, x: State, length: float, speed: float) -> Fiber:
        activation, fiber_length = self._states(k, x)
        if not self.is_elastic:
            return self.contraction.beside_rigid_tendon(k, length, speed)
        return self.contraction.beside_elastic_tendon(k, activation, length, fiber_length)


class ActivationDynamics(Protocol):
    """How activation follows excitation."""

    @property
    def least(self) -> Any:
        """Least activation."""

    def rate(self, k: Any, e: Any, a: Any) -> Any:
        """Rate of the activation a under the excitation e [1/s]."""


class FirstOrder(NamedTuple):
    """a' = (e - a) / tau, tau by whether activation rises.

    With z = 0.5 + 1.5 a, tau = rising z where e > a, and falling / z where not. The rate is
    continuous and has a kink at e = a.

    Source: D. G. Thelen, J. Biomech. Eng. 125, 2003, 70-77, doi:10.1115/1.1531112, eq. 1 and 2.

    Attributes:
        rising: Time constant [s].
        falling: Time constant [s].
        least: The a_min.
    """

    rising: Number
    falling: Number
    least: Number

    def rate(self, k: Any, e: Number, a: Number) -> Number:
        """A' [1/s]."""
        factor = _LEAST + _MORE * a
        lack = k.minimum(k.maximum(e, self.least), 1.0) - a
        up, down = k.maximum(lack, 0.0), k.minimum(lack, 0.0)
        return up / (self.rising * factor) + down * factor / self.falling


class SmoothFirstOrder(NamedTuple):
    """a' = ((f + 1/2) / (rising z) + (1/2 - f) z / falling) (e - a), smooth everywhere.

    Here z = 0.5 + 1.5 a and f = tanh(b (e - a)) / 2.

    Source: F. De Groote et al., Ann. Biomed. Eng. 44, 2016, 2922-2936,
    doi:10.1007/s10439-016-1591-9, eq. 1 and 2.

    Attributes:
        rising: Time constant [s].
        falling: Time constant [s].
    """

    rising: Number
    falling: Number
    least: Number
    steepness: Number

    def rate(self, k: Any, e: Number, a: Number) -> Number:
        """A' [1/s]."""
        factor = _LEAST + _MORE * a
        lack = k.minimum(k.maximum(e, self.least), 1.0) - a
        side = 0.5 * k.tanh(self.steepness * lack)
        pace = (side + 0.5) / (self.rising * factor) + (0.5 - side) * factor / self.falling
        return pace * lack

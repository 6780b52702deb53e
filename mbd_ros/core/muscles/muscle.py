"""Hill-type muscle: a tension along a path, with activation and fibre length as states."""

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
_Z0, _Z1 = 0.5, 1.5  # z = 0.5 + 1.5 a, the factor of both time constants


class Muscle(PathLoad, Actuator):
    """A muscle along a path, whose command is its excitation.

    Args:
        path: Path of the muscle.
        contraction: Contraction dynamics of fibres and tendon.
        dynamics: Activation dynamics.
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
        """Return the tendon force [N]."""
        activation, fiber_length = self._states(k, x)
        if self.is_elastic:
            return self.contraction.tendon(k, length, fiber_length)
        return self.contraction.rigid_tension(k, activation, length, speed)

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the rates of activation and fibre length [1/s, m/s]."""
        activation, fiber_length = self._states(k, x)
        rate = self.dynamics.rate(k, k.item(u, self.u.start or 0), activation)
        if not self.is_elastic:
            return k.array([rate])
        length = self.path.length(k, x)
        fiber = self.contraction.beside_elastic_tendon(k, activation, length, fiber_length)
        return k.array([rate, fiber.velocity])

    def balance(self, k: Kinematics, x: State, u: Array, w: Array) -> Array:
        """Return residuals that vanish at the rates w, for collocation.

        The second one is the equilibrium of fibres and tendon, scaled by peak force and largest
        speed.
        """
        activation, fiber_length = self._states(k, x)
        residual = k.item(w, 0) - self.dynamics.rate(k, k.item(u, self.u.start or 0), activation)
        if not self.is_elastic:
            return k.array([residual])
        length, speed = self.path.length(k, x), k.item(w, 1)
        lacking = self.contraction.lacking(k, activation, length, fiber_length, speed)
        return k.array([residual, self.contraction.fastest * lacking])

    def at_rest(self, k: Kinematics, x: State, u: Array) -> Array | None:
        """Return activation and fibre length in equilibrium, with the shortest stable length."""
        z = x.z[self.z].copy()
        z[0] = self._initial_activation(x, u)
        if self.is_elastic and math.isnan(z[1]):
            z[1] = self.stable_lengths(z[0], self.path.length(k, x))[0]
        return z

    def choices_at_rest(self, k: Kinematics, x: State, u: Array) -> list[float]:
        """Return the stable fibre lengths among which `at_rest` chooses [m], [] for no choice.

        Args:
            k: Kinematics at the state.
            x: State of all joints; z is NaN where the equilibrium is sought.
            u: All inputs.
        """
        if not self.is_elastic or not math.isnan(x.z[self.z][1]):
            return []
        lengths = self.stable_lengths(self._initial_activation(x, u), self.path.length(k, x))
        return lengths if len(lengths) > 1 else []

    def stable_lengths(self, activation: float, length: float) -> list[float]:
        """Return the stable fibre lengths at rest, in increasing order [m].

        Args:
            activation: Activation, from its lower bound to 1.
            length: Length of the path [m].
        """
        return stable_lengths(self.contraction, activation, length)

    def command(self, torque: Array, x: State) -> Array:
        """Return the lowest excitation, shape (1,): torques do not determine the excitation."""
        return np.full(1, self.inputs[0].safe)

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the energy of tendon and passive fibres [J]."""
        length, fiber_length = self.path.length(k, x), self._states(k, x)[1]
        if self.is_elastic:
            energy = self.contraction.tendon_energy(k, length, fiber_length)
            return energy + self.contraction.fiber_energy(k, fiber_length)
        fiber = self.contraction.beside_rigid_tendon(k, length, 0.0)
        return self.contraction.fiber_energy(k, fiber.length)

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """Return zeros, shape (nv, 1): the excitation acts only through the activation."""
        return np.zeros((len(x.v), 1))

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Return forces, fibre states and powers; `fiber_power` is that of the active force."""
        activation, _ = self._states(k, x)
        length, slope = self.path.measured(k, x)
        speed = k.dot(slope, x.v)
        fiber = self._fiber(k, x, length, speed)
        active = self.contraction.active(k, activation, fiber)
        damping = self.contraction.damping(fiber)
        outputs = (
            self.tension(k, x, u, length, speed),
            length,
            fiber.velocity,
            active,
            self.contraction.passive(k, fiber),
            -active * fiber.velocity,
            damping * fiber.velocity,
        )
        return outputs if self.is_elastic else (*outputs, fiber.length)

    def metabolic_rate(
        self, k: Kinematics, x: State, u: Array, numbers: Metabolism = USUAL_METABOLISM
    ) -> float:
        """Return the metabolic rate of the muscle [W], see `metabolic_rate`.

        Args:
            k: Kinematics at the state.
            x: State of all joints.
            u: All inputs.
            numbers: Metabolic parameters of its fibres.
        """
        activation, _ = self._states(k, x)
        length, slope = self.path.measured(k, x)
        fiber = self._fiber(k, x, length, k.dot(slope, x.v))
        excitation = k.item(u, self.u.start or 0)
        rate: float = metabolic_rate(k, self.contraction, activation, excitation, fiber, numbers)
        return rate

    def active_force(self, length: Array, speed: Array) -> Array:
        """Return the force of fully active fibres along a rigid tendon [N].

        The force at activation a is a times this force, except for `thelen`, whose force-velocity
        curve depends on a.

        Args:
            length: Length of the path [m], any shape.
            speed: Rate of the length [m/s], same shape.
        """
        fiber = self.contraction.beside_rigid_tendon(ArrayNumbers, length, speed)
        force: Array = self.contraction.active(ArrayNumbers, 1.0, fiber) * fiber.cosine
        return force

    def passive_force(self, length: Array) -> Array:
        """Return the passive force of the fibres along a rigid tendon [N].

        Args:
            length: Length of the path [m], any shape.
        """
        fiber = self.contraction.beside_rigid_tendon(ArrayNumbers, length, 0.0 * length)
        force: Array = self.contraction.passive(ArrayNumbers, fiber) * fiber.cosine
        return force

    def fiber_length(self, length: Array) -> Array:
        """Return the fibre length with a rigid tendon [m] at a length of the path [m]."""
        fiber_length: Array = self.contraction.pennation.fiber(
            ArrayNumbers, length - self.contraction.slack
        )
        return fiber_length

    def fiber_velocity(self, length: Array, speed: Array) -> Array:
        """Return the rate of the fibre length with a rigid tendon [m/s].

        Args:
            length: Length of the path [m], any shape.
            speed: Rate of the length [m/s], same shape.
        """
        fiber = self.contraction.beside_rigid_tendon(ArrayNumbers, length, speed)
        velocity: Array = fiber.velocity
        return velocity

    def _initial_activation(self, x: State, u: Array) -> float:
        """Return the activation in z, or that of the excitation in equilibrium if it is NaN."""
        activation = float(x.z[self.z][0])
        if math.isnan(activation):
            return min(max(u[self.u].item(), self.dynamics.least), 1.0)
        return activation

    def _states(self, k: Kinematics, x: State) -> tuple[float, float]:
        """Return activation and fibre length; the length is 0 with a rigid tendon."""
        first = self.z.start or 0
        return k.item(x.z, first), k.item(x.z, first + 1) if self.is_elastic else 0.0

    def _fiber(self, k: Kinematics, x: State, length: float, speed: float) -> Fiber:
        activation, fiber_length = self._states(k, x)
        if not self.is_elastic:
            return self.contraction.beside_rigid_tendon(k, length, speed)
        return self.contraction.beside_elastic_tendon(k, activation, length, fiber_length)


class ActivationDynamics(Protocol):
    """Activation dynamics: the rate of the activation as a function of the excitation."""

    @property
    def least(self) -> Any:
        """Lower bound of the activation."""

    def rate(self, k: Any, e: Any, a: Any) -> Any:
        """Return the rate of the activation a under the excitation e [1/s]."""


class FirstOrder(NamedTuple):
    """First-order activation dynamics: a' = (e - a) / tau.

    With z = 0.5 + 1.5 a, tau = rising z where e > a and tau = falling / z elsewhere. The rate is
    continuous, with a kink at e = a.

    Source: D. G. Thelen, J. Biomech. Eng. 125, 2003, 70-77, doi:10.1115/1.1531112, eq. 1 and 2.

    Attributes:
        rising: Time constant of rising activation [s].
        falling: Time constant of falling activation [s].
        least: Lower bound of the activation.
    """

    rising: Number
    falling: Number
    least: Number

    def rate(self, k: Any, e: Number, a: Number) -> Number:
        """Return a' [1/s]."""
        factor = _Z0 + _Z1 * a
        difference = k.minimum(k.maximum(e, self.least), 1.0) - a
        up, down = k.maximum(difference, 0.0), k.minimum(difference, 0.0)
        return up / (self.rising * factor) + down * factor / self.falling


class SmoothFirstOrder(NamedTuple):
    """Smooth first-order activation dynamics.

        a' = ((f + 1/2) / (rising z) + (1/2 - f) z / falling) (e - a)

    Here z = 0.5 + 1.5 a and f = tanh(b (e - a)) / 2.

    Source: F. De Groote et al., Ann. Biomed. Eng. 44, 2016, 2922-2936,
    doi:10.1007/s10439-016-1591-9, eq. 1 and 2.

    Attributes:
        rising: Time constant of rising activation [s].
        falling: Time constant of falling activation [s].
        least: Lower bound of the activation.
        steepness: Steepness b of the transition between both time constants.
    """

    rising: Number
    falling: Number
    least: Number
    steepness: Number

    def rate(self, k: Any, e: Number, a: Number) -> Number:
        """Return a' [1/s]."""
        factor = _Z0 + _Z1 * a
        difference = k.minimum(k.maximum(e, self.least), 1.0) - a
        f = 0.5 * k.tanh(self.steepness * difference)
        inverse_tau = (f + 0.5) / (self.rising * factor) + (0.5 - f) * factor / self.falling
        return inverse_tau * difference

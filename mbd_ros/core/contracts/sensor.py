"""Contract of sensors: what of a mechanism is measured.

The same sensors serve a simulator (with noise), marker kinematics and estimators: a sensor says
what an exact measurement would be, how that changes with the state, and how noisy it is.
"""

from enum import IntEnum

import numpy as np

from mbd_ros.core.contracts.outputs import Now
from mbd_ros.core.contracts.parts import Part
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.points import Point
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class Measures(IntEnum):
    """What a measurement depends on besides what stands above it."""

    POSITION = 0
    VELOCITY = 1
    ACCELERATION = 2
    FORCE = 3


class Sensor(Part):
    """What of a mechanism is measured; it has no influence on the motion.

    Attributes:
        level: What a measurement depends on at most.
        unit: Of every component.
        components: Names of the components, one empty word for a single number.
        label: What recordings and messages call the sensor; its name by default.
        delay: From a measurement to its message [s]; the message carries the time of the
            measurement.
        is_linear: Whether it is a constant linear function of q and v: `jacobian` and
            `by_position` never change.
        noise_varies: Whether `covariance` depends on the state.
    """

    level: Measures = Measures.POSITION
    unit: str = ""
    components: tuple[str, ...] = ("",)
    label: str = ""
    delay: float = 0.0
    is_linear: bool = False
    noise_varies: bool = False

    @property
    def title(self) -> str:
        """What recordings and messages call it."""
        return self.label or self.name

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """An exact measurement, shape (n,) of as many components.

        Args:
            k: Kinematics at the state, refreshed as far as `reads` says.
            x: State of all joints.
            now: Accelerations and multipliers; needed from `Measures.ACCELERATION` on, with
                reactions for `Measures.FORCE`.
        """
        raise NotImplementedError

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Derivative by q, v or a, whichever `level` says, shape (n, nv); not asked for forces.

        Args:
            k: Kinematics at the state, refreshed to Jacobians.
            x: State of all joints.
        """
        raise NotImplementedError

    def by_position(self, k: Kinematics, x: State) -> Array | None:
        """Derivative by a step of q at constant velocity, shape (n, nv), where `level` is higher.

        None by default: who needs it takes differences of `measure`.
        """
        return None

    def by_internal(self, nz: int) -> Array | None:
        """Constant derivative by all internal states, shape (n, nz); None for none."""
        return None

    def near(self, values: Array, expected: Array) -> Array:
        """Measured values as near to the expected ones as they can be written; themselves here."""
        return values

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Covariance of the noise [unit^2], shape (n, n); none by default."""
        return np.zeros((len(self.components), len(self.components)))


def reactions_of(sensor: Sensor, now: Now | None) -> Array:
    """Reactions of all joints, as `Now.reactions`.

    Raises:
        ModelError: They are not given.
    """
    if now is None or now.reactions is None:
        raise ModelError(f"{sensor.name} needs reactions of joints, and none are known")
    return now.reactions


def specific_force(
    sensor: Sensor, k: Kinematics, point: Point, now: Now | None, gravity: Array
) -> Array:
    """R' (a - g) of a point, in its axes: what an accelerometer feels [m/s^2], shape (3,).

    Args:
        sensor: Who asks, for the message.
        k: Kinematics at the state, refreshed to drifts.
        point: Where it is.
        now: Accelerations.
        gravity: In the world [m/s^2], shape (3,).

    Raises:
        ModelError: Accelerations are not given.
    """
    if now is None:
        raise ModelError(f"{sensor.name} needs accelerations, and none are known")
    moved = k.jacobian(point).dot(now.a) + k.acceleration(point)
    felt: Array = k.rotation(point).T.dot(moved - gravity)
    return felt

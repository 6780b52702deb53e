"""Simulated measurements: exact values plus noise that depends only on seed, sensor and sample.

The noise comes from the counter-based generator Philox, keyed by seed and sensor, so that the
numbers of one sensor do not depend on other sensors. Source: J. K. Salmon et al., Parallel random
numbers: as easy as 1, 2, 3, SC11 (2011).
"""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.contracts import Measures, Now, Sensor
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.state import Array, State


class NoisySensors:
    """Measurements of a simulation with noise.

    Args:
        sensors: The sensors.
        seed: Seed of the noise.

    Attributes:
        needs_reactions: Whether a sensor measures forces in joints.
    """

    def __init__(self, sensors: Sequence[Sensor], seed: int) -> None:
        self.sensors = tuple(sensors)
        self._seed = seed
        self._reads = max((sensor.reads for sensor in sensors), default=Reads.NOTHING)
        self.needs_reactions = any(sensor.level >= Measures.FORCE for sensor in sensors)
        self._roots: dict[int, Array] = {}

    def at(self, system: System, x: State, now: Now, sample: int) -> list[Array]:
        """Return the measurement of each sensor.

        Args:
            system: System of the simulation.
            x: State of all joints.
            now: Accelerations and multipliers at x, with reactions if `needs_reactions`.
            sample: Number of the sample, >= 0.
        """
        k = system.k
        k.refresh(x.q, x.v, self._reads)
        measurements = []
        for i, sensor in enumerate(self.sensors):
            exact = np.asarray(sensor.measure(k, x, now), dtype=np.float64)
            random = np.random.Generator(np.random.Philox(key=[self._seed, i], counter=sample))
            measurements.append(
                exact + self._root(i, sensor, k, x).dot(random.standard_normal(len(exact)))
            )
        return measurements

    def _root(self, i: int, sensor: Sensor, k: Kinematics, x: State) -> Array:
        """Return L such that L L' is the covariance of a sensor."""
        if i not in self._roots or sensor.noise_varies:
            values, vectors = np.linalg.eigh(sensor.covariance(k, x))
            self._roots[i] = vectors * np.sqrt(np.maximum(values, 0.0))
        return self._roots[i]

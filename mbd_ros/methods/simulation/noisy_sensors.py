"""What sensors tell of a simulation: exact values and noise that only depends on seed and sample.

Source of the noise: J. K. Salmon et al., Parallel random numbers: as easy as 1, 2, 3, SC11 (2011),
a counter (Philox) keyed by seed and sensor, so that no sensor changes what another one shows.
"""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.contracts import Measures, Now, Sensor
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.state import Array, State


class NoisySensors:
    """Measurements of a simulation.

    Args:
        seed: Of the noise.

    Attributes:
        needs_reactions: Whether one of them feels forces in joints.
    """

    def __init__(self, sensors: Sequence[Sensor], seed: int) -> None:
        self.sensors = tuple(sensors)
        self._seed = seed
        self._reads = max((sensor.reads for sensor in sensors), default=Reads.NOTHING)
        self.needs_reactions = any(one.level >= Measures.FORCE for one in sensors)
        self._roots: dict[int, Array] = {}

    def at(self, system: System, x: State, now: Now, sample: int) -> list[Array]:
        """What each sensor tells.

        Args:
            system: Of the simulation.
            now: Accelerations and multipliers there, with reactions where they are needed.
            sample: Number of the sample, >= 0.
        """
        k = system.k
        k.refresh(x.q, x.v, self._reads)
        found = []
        for i, sensor in enumerate(self.sensors):
            exact = np.asarray(sensor.measure(k, x, now), dtype=np.float64)
            random = np.random.Generator(np.random.Philox(key=[self._seed, i], counter=sample))
            found.append(
                exact + self._root(i, sensor, k, x).dot(random.standard_normal(len(exact)))
            )
        return found

    def _root(self, i: int, sensor: Sensor, k: Kinematics, x: State) -> Array:
        """L with L L' the covariance of a sensor."""
        if i not in self._roots or sensor.noise_varies:
            values, vectors = np.linalg.eigh(sensor.covariance(k, x))
            self._roots[i] = vectors * np.sqrt(np.maximum(values, 0.0))
        return self._roots[i]

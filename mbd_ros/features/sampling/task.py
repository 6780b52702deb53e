"""The `sample` section of a task file: the ensemble of a scene that is sampled."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Any, Literal

from mbd_ros.core.ranges import NotNegative, Positive, Within
from mbd_ros.errors import SceneError
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema

Count = Annotated[int, Within(1, 100_000_000)]
Samples = Annotated[int, Within(8, 100_000_000)]  # fewer say nothing of the error of an average
Chains = Annotated[int, Within(2, 1_000_000)]
Seed = Annotated[int, Within(0, 2**63 - 1)]

HISTOGRAM, PROFILE = "histogram.", "profile"  # tables of a result; a quantity follows the first


@dataclass(frozen=True)
class SampleTask:
    """The ensemble of a scene that is sampled; its arguments are the keys of a task file.

    Args:
        temperature: Temperature [K]; in reduced units the thermal energy kT itself.
        thermal_energy: Thermal energy kT in the unit of energy of the scene, in place of the
            temperature.
        method: metropolis is exact up to the statistical error. langevin has an error that falls
            with the square of the step.
        chains: Number of chains.
        samples: Samples of each chain.
        warmup: Samples of each chain that are discarded before the others.
        steps: Steps between samples. By default 5 for particles and 20 for mechanisms.
        dt: Step. By default it is chosen.
        friction: Rate at which langevin damps velocities. By default it is chosen.
        seed: Seed of the random numbers.
        fixman: Take the constraints as the limit of stiff springs (Fixman's potential).
        starts: Initial configurations of the chains: that of the scene, or random ones on the
            constraints.
        components: Whether to search for separate components of the constraint manifold. By
            default only small scenes do.
        kinetics: Also compare the kinetic energies of translation, rotation and the remaining
            motion with those of a step of SHAKE.
        observe: Quantity to record, such as 'distance A B', 'cosine A B C' or a joint. A task
            file gives each a name.
        histograms: Bins of quantities: [low, high, number].
        coordinate: Quantity, constraint or joint along which the mean force is computed.
        at: Values of the coordinate.
    """

    temperature: NotNegative | None = None
    thermal_energy: NotNegative | None = None
    method: Literal["metropolis", "langevin"] = "metropolis"
    chains: Chains = 64
    samples: Samples = 1000
    warmup: Annotated[int, Within(0, 100_000_000)] = 200
    steps: Count | None = None
    dt: Positive | None = None
    friction: NotNegative | None = None
    seed: Seed = 0
    fixman: bool = False
    starts: Literal["scene", "random"] = "scene"
    components: bool | None = None
    kinetics: bool = False
    observe: Mapping[str, str] = field(default_factory=dict)
    histograms: Mapping[str, Sequence[float]] = field(default_factory=dict)
    coordinate: str | None = None
    at: Sequence[float] = ()


def build_task(site: Site, entry: Any) -> SampleTask:
    """Build the `sample` section of a task file."""
    return sample_task(entry, site.where)


def sample_task(entry: Any, where: str) -> SampleTask:
    """Build a task from the keys of the section `sample`.

    Args:
        entry: Values by key.
        where: File and key, for messages.

    Raises:
        SceneError: A key is unknown or its value is not accepted; the message names both.
    """
    task: SampleTask = schema.call(SampleTask, entry, where)
    if (task.temperature is None) == (task.thermal_energy is None):
        raise SceneError(f"{where}: expected one of temperature and thermal_energy")
    if not (task.temperature or task.thermal_energy):
        raise SceneError(f"{where}: the temperature must be > 0")
    if task.friction is not None and task.method != "langevin":
        raise SceneError(f"{where}.friction: {task.method} has none; accepted with langevin")
    if (task.coordinate is None) != (not task.at):
        raise SceneError(f"{where}: coordinate and at go together")
    steps = [b - a for a, b in pairwise(task.at)]
    if steps and not (min(steps) > 0.0 or max(steps) < 0.0):
        raise SceneError(f"{where}.at: {task.at}, expected values that rise or fall")
    for name, bins in task.histograms.items():
        if len(bins) != 3 or not bins[0] < bins[1] or bins[2] not in range(1, 10_001):
            raise SceneError(f"{where}.histograms.{name}: {bins}, expected [low, high, number]")
    return task

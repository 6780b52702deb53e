"""The `sample` section of a task file: which ensemble is asked of a scene."""

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
    """An ensemble, asked of a scene.

    Args:
        temperature: [K]; in reduced units the thermal energy itself.
        thermal_energy: kT, in place of it, in the unit of energy of the scene [J].
        method: `metropolis` is exact up to the error of sampling, `langevin` has an error that
            falls with the square of dt.
        samples: Samples a chain, enough for an error of averages.
        warmup: Samples a chain before them, which are not kept.
        steps: Steps between samples; None: 5 of particles, 20 of mechanisms.
        dt: Step; None chooses.
        friction: Rate at which `langevin` forgets velocities; None chooses.
        seed: Of the random numbers.
        fixman: Whether rows are the limit of stiff springs (Fixman's potential).
        starts: Where chains begin: `scene`, or `random` configurations on the rows.
        components: Whether components of the manifold are looked for; None: in small scenes.
        kinetics: Whether kinetic energies are divided into translation, rotation and the rest,
            and compared with those of a step of SHAKE.
        observe: Quantities by name: `distance a b`, `cosine a b c`, .., or a joint.
        histograms: Bins of quantities: [low, high, number].
        coordinate: Quantity along which the mean force is asked for.
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


def build_task(site: Site, given: Any) -> SampleTask:
    """The `sample` section of a task file."""
    return sample_task(given, site.where)


def sample_task(given: Any, where: str) -> SampleTask:
    """The task of some entries.

    Args:
        given: Entries by key.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    task: SampleTask = schema.call(SampleTask, given, where)
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

"""What learning is asked for, and what it returns."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.learn.linear_corrections import Known
from mbd_ros.features.identification.learn.training_samples import Scales
from mbd_ros.files.table import Table
from mbd_ros.methods.learned import About
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene

VARIANTS = ("free", "structured", "informed")
PHYSICS = ("identified", "given")
FREEZE = ("physics", "all-but adapters")
_STEPS = {"free": 400, "structured": 300, "informed": 400}


class Task(NamedTuple):
    """What is asked for.

    Attributes:
        motions: Results, files or bags.
        wrenches: Of tables with external loads, one a motion, or none.
        topic: JointState topic of bags.
        derivatives: given or zero-phase; None: given where a motion has accelerations.
        band: End of the band of motions and efforts [Hz]; None: from the motion.
        learned: Share of the time of each recording that is learned from.
        variant: One of `VARIANTS`.
        physics: One of `PHYSICS`: what the network stands on.
        freeze: One of `FREEZE`.
        start: Weights of an earlier model, where one is adapted.
        members: Networks of the ensemble.
        steps: Of the optimisation; None: by variant.
        seed: Of the random numbers.
        rate: First learning rate of the optimisation.
    """

    motions: Sequence[Source]
    wrenches: Sequence[Source] = ()
    topic: str = "/joint_states"
    derivatives: str | None = None
    band: float | None = None
    learned: float = 0.6
    variant: str = "free"
    physics: str = "identified"
    freeze: str = "physics"
    start: "Learned | None" = None
    members: int = 5
    steps: int | None = None
    seed: int = 0
    rate: float = 1.0e-2

    @property
    def rounds(self) -> int:
        """Steps of the optimisation."""
        return self.steps or _STEPS[self.variant]

    def check(self) -> None:
        """Refuse values without a meaning.

        Raises:
            DataError: Names the option and what is accepted.
        """
        for key, value, accepted in (
            ("variant", self.variant, VARIANTS),
            ("physics", self.physics, PHYSICS),
            ("freeze", self.freeze, FREEZE),
        ):
            if value not in accepted:
                raise DataError(f"--{key} {value}: accepted are {', '.join(accepted)}")
        if not 0.1 <= self.learned <= 1.0:
            raise DataError(f"--learned {self.learned:g}: accepted are 0.1 .. 1")
        if not 2 <= self.members <= 20:
            raise DataError(f"--members {self.members}: accepted are 2 .. 20")
        if not 1 <= self.rounds <= 100_000:
            raise DataError(f"--steps {self.rounds}: accepted are 1 .. 100000")
        if not 0.0 < self.rate <= 1.0:
            raise DataError(f"--rate {self.rate:g}: must be > 0 and <= 1")
        if self.band is not None and not 0.0 < self.band < float("inf"):
            raise DataError(f"--band {self.band:g}: must be finite and > 0")


class Learned(NamedTuple):
    """A learned model.

    Attributes:
        about: What it belongs to.
        scales: Of inputs and outputs.
        weights: Members first, as in `network`.
        trust: Share of the torque of each joint that is given, shape (m,).
        known: What was learned from says of linear numbers.
        numbers: Corrections of inertias, friction and stiffness, shape (p,).
    """

    about: About
    scales: Scales
    weights: Mapping[str, Array]
    trust: Array
    known: Known
    numbers: Array


class Outcome(NamedTuple):
    """What learning found.

    Attributes:
        content: Its ONNX file.
        scene: The scene that it stands on, without it.
        tables: `validation`: errors of what was not learned from, a joint a row.
        errors: Share of the torque that is not explained there: `physics`, `learned`.
        remarks: Lines for people.
    """

    model: Learned
    content: bytes
    scene: Scene
    tables: dict[str, Table]
    errors: dict[str, float]
    remarks: list[str]

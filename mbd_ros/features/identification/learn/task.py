"""Options and result of learning a torque model."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.learn.linear_corrections import SampleStatistics
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
    """Options of learning.

    Attributes:
        motions: Results, files or bags.
        wrenches: Tables with external loads, one per motion, or none.
        topic: JointState topic of bags.
        derivatives: given or zero-phase; None: given where a motion has accelerations.
        band: End of the frequency band of motions and efforts [Hz]; None: from the motion.
        learned: Share of the time of each recording that is used for training.
        variant: One of `VARIANTS`.
        physics: One of `PHYSICS`: the scene that the network corrects.
        freeze: One of `FREEZE`.
        start: Earlier model that is adapted; None for a new model.
        members: Number of networks in the ensemble.
        steps: Steps of the optimization; None: by variant.
        seed: Seed of the random numbers.
        rate: Initial learning rate of the optimization.
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
    start: "LearnedModel | None" = None
    members: int = 5
    steps: int | None = None
    seed: int = 0
    rate: float = 1.0e-2

    @property
    def optimization_steps(self) -> int:
        """Number of steps of the optimization."""
        return self.steps or _STEPS[self.variant]

    def check(self) -> None:
        """Refuse values outside of their ranges.

        Raises:
            DataError: A value is not accepted; the message names the option and what is accepted.
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
        if not 1 <= self.optimization_steps <= 100_000:
            raise DataError(f"--steps {self.optimization_steps}: accepted are 1 .. 100000")
        if not 0.0 < self.rate <= 1.0:
            raise DataError(f"--rate {self.rate:g}: must be > 0 and <= 1")
        if self.band is not None and not 0.0 < self.band < float("inf"):
            raise DataError(f"--band {self.band:g}: must be finite and > 0 Hz")


class LearnedModel(NamedTuple):
    """A learned model.

    Attributes:
        about: Description that the file contains: joints, robot, range of training data, ...
        scales: Scales of inputs and outputs.
        weights: Weights by name, with members along the first axis, as in `network`.
        trust: Factor of the torque of the network for each joint, 0 .. 1, shape (m,).
        known: Statistics of all training samples for the linear corrections.
        numbers: Corrections of inertias, friction and stiffness, shape (p,).
    """

    about: About
    scales: Scales
    weights: Mapping[str, Array]
    trust: Array
    known: SampleStatistics
    numbers: Array


class Outcome(NamedTuple):
    """Result of learning.

    Attributes:
        model: The learned model.
        content: The ONNX file of the model.
        scene: The scene that the model corrects, without the model.
        tables: `validation`: errors in the test, one joint per row.
        errors: Relative errors of the torques in the test: `physics`, `learned`.
        remarks: Lines for people.
    """

    model: LearnedModel
    content: bytes
    scene: Scene
    tables: dict[str, Table]
    errors: dict[str, float]
    remarks: list[str]

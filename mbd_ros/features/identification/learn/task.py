"""Options and result of learning a torque model."""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, get_args

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.learn.linear_corrections import SampleStatistics
from mbd_ros.features.identification.learn.training_samples import Scales
from mbd_ros.files.table import Table
from mbd_ros.methods.learned_model import About
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene

Variant = Literal["free", "structured", "informed"]
Physics = Literal["identified", "given"]
VARIANTS = get_args(Variant)
PHYSICS = get_args(Physics)
FREEZE = ("physics", "all-but adapters")
_STEPS = {"free": 400, "structured": 300, "informed": 400}


class Task(NamedTuple):
    """Options of learning.

    Attributes:
        motions: Results, tables or bags with positions and efforts.
        wrenches: Tables of the external loads, one per motion; a bag contains its own.
        topic: JointState topic of bags.
        derivatives: Source of velocities and accelerations. By default given for a motion with
            accelerations, else zero-phase.
        band: End of the frequency band of motions and efforts [Hz]. By default it is chosen from
            the motion.
        learned: Share of the time of each recording that is used for training.
        variant: free: a network without structure. structured: friction and a Lagrangian.
            informed: as free, but it follows the equations of motion where there are no data.
        physics: Scene that the network corrects: first identified from the same samples, or as
            given.
        freeze: Part that does not change while the model of `start` is adapted: physics, or
            all-but adapters.
        start: Earlier model that is adapted. By default a new model is trained.
        members: Number of networks in the ensemble.
        steps: Steps of the optimization. By default they depend on the variant.
        seed: Seed of the random numbers.
        rate: Initial learning rate of the optimization.
    """

    motions: Sequence[Source]
    wrenches: Sequence[Source] = ()
    topic: str = "/joint_states"
    derivatives: Literal["given", "zero-phase"] | None = None
    band: float | None = None
    learned: float = 0.6
    variant: Variant = "free"
    physics: Physics = "identified"
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

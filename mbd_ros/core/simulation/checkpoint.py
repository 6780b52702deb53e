"""What a run remembers at a sample, as a value."""

from typing import NamedTuple

from mbd_ros.core.memory import Memory
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError


class Progress(NamedTuple):
    """How far a run is.

    Attributes:
        origin: Its first time [s]; samples are at origin + sample dt.
        sample: Number of the newest one; the first is 0.
        y: What is integrated, after the last step.
        is_within: Whether the last step has samples inside that are still to come.
        held_since: When inputs jumped last [s].
    """

    origin: float
    sample: int
    y: State
    is_within: bool
    held_since: float


class Checkpoint(NamedTuple):
    """A simulation at a sample; one of the same scene, method and dt continues with the same bits.

    It holds numbers and arrays only, and can be pickled.

    Attributes:
        made_by: Method, dt [s], and sizes of what is integrated.
        progress: How far the run is.
        steps: Steps taken so far.
        worst: As of the `Simulation`.
        stops: What is known of stops that were passed; empty without stops.
        memory: What the method remembers of earlier steps.
    """

    made_by: tuple[str, float, int, int, int]
    progress: Progress
    steps: int
    worst: tuple[float, float]
    stops: Memory
    memory: Memory


def refuse_other(checkpoint: Checkpoint, made_by: tuple[str, float, int, int, int]) -> None:
    """Refuse a checkpoint of something else.

    Raises:
        ModelError: It is one of another method or dt, or of other sizes.
    """
    if checkpoint.made_by != made_by:
        texts = (_words(*made) for made in (checkpoint.made_by, made_by))
        raise ModelError("a checkpoint of {} cannot be continued by {}".format(*texts))


def _words(method: str, dt: float, nq: int, nv: int, nz: int) -> str:
    """What made a checkpoint, for messages; arguments are `Checkpoint.made_by`."""
    states = f", {nv} velocities and {nz} internal states" if nz else f" and {nv} velocities"
    return f"{method} with dt {dt:g} s, {nq} positions{states}"
